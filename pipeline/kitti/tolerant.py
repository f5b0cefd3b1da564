"""Read files of single frames, some of which may be damaged."""

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from pipeline.base import progress
from pipeline.base.errors import DamagedFile, error_context

Read = Callable[[Path], np.ndarray]


class TolerantReader:
    """Read files of single frames. A damaged file is an error or, if `tolerant`, skipped and counted by kind."""

    def __init__(self, tolerant: bool, passes: int = 1) -> None:
        """`passes`: calls of :meth:`each` per drive; a frame counts as progress once every `passes` frames."""
        self._tolerant, self._passes, self._visited = tolerant, passes, 0
        self.damaged: Counter[str] = Counter()

    def each(
        self, kind: str, read: Read, files: Mapping[int, Path], frames: Sequence[int]
    ) -> Iterator[tuple[int, np.ndarray]]:
        """Yield (position in `frames`, array) for each of `frames` with an intact file of this `kind`.

        Raises DamagedFile unless damaged files are tolerated.
        """
        for index, frame in enumerate(frames):
            try:
                with error_context(fix="Extract it again, or set ingest.on_damaged: skip to leave it out"):
                    array = read(files[frame]) if frame in files else None
            except DamagedFile:
                if not self._tolerant:
                    raise
                self.damaged[kind] += 1
                array = None
            if array is not None:
                yield index, array
            self._visited += 1
            if self._visited % self._passes == 0:
                progress.advance(1)
