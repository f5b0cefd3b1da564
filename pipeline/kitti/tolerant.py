"""Reading files of single frames where some may be damaged."""

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from pipeline.base.errors import DamagedFile, error_context

Read = Callable[[Path], np.ndarray]


class TolerantReader:
    """Reads files of single frames; a damaged one is an error, or, if `tolerant`, left out and counted by kind."""

    def __init__(self, tolerant: bool) -> None:
        self._tolerant = tolerant
        self.damaged: Counter[str] = Counter()

    def each(
        self, kind: str, read: Read, files: Mapping[int, Path], frames: Sequence[int]
    ) -> Iterator[tuple[int, np.ndarray]]:
        """Yield (position in `frames`, array) for each of `frames` that has a sound file; `kind` names the files.

        Raises DamagedFile, with what can be done, unless damaged files are tolerated.
        """
        for index, frame in enumerate(frames):
            array = self._read(kind, read, files[frame]) if frame in files else None
            if array is not None:
                yield index, array

    def _read(self, kind: str, read: Read, file: Path) -> np.ndarray | None:
        try:
            with error_context(fix="Extract it again, or set ingest.on_damaged: skip to leave it out"):
                return read(file)
        except DamagedFile:
            if not self._tolerant:
                raise
            self.damaged[kind] += 1
            return None
