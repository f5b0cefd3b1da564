"""Two files of a drive, whichever stage wrote them: matched by frame number, read in parts that memory holds."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.base.errors import InputError
from pipeline.base.store import DriveReader
from pipeline.inspect.compare.difference import Difference, Tally
from pipeline.inspect.compare.values import of_values
from pipeline.inspect.drive_file import opened

_WHOLE_BYTES = 16 << 20  # datasets up to this size are read at once


def compare(a: Path, b: Path, name: str, tolerance: float) -> Iterator[Difference]:
    """Yield where two files of drives differ. Raises InputError if one is damaged or no stage's."""
    with opened(a) as one, opened(b) as other:
        yield from of_values(_about(one), _about(other), name, tolerance)
        names, others = _names(one), _names(other)
        for dataset in sorted(names ^ others):
            yield Difference(name, dataset, f"only in {'A' if dataset in names else 'B'}", one.drive)
        frames, rows, other_rows = np.intersect1d(one.frame, other.frame, return_indices=True)
        for file, which in ((one, "A"), (other, "B")):
            alone = np.setdiff1d(file.frame, frames)
            if len(alone):
                how = f"{len(alone)} only in {which}, first {alone[0]}"
                yield Difference(name, "frame", how, one.drive)
        for dataset in sorted((names & others) - {"frame"}):
            sides = _Side(one, dataset, rows), _Side(other, dataset, other_rows)
            found = _dataset(*sides, frames, tolerance)
            difference = found.difference(name, dataset, _form(*sides), drive=one.drive, unit=sides[0].unit)
            if difference:
                yield difference


def _names(file: DriveReader) -> set[str]:
    return set(file.dataset("frame").parent)


def _about(file: DriveReader) -> dict[str, Any]:
    plain = {key: value.item() if isinstance(value, np.generic) else value for key, value in file.attrs.items()}
    return plain | {"params": json.loads(str(plain["params"]))}


class _Side:
    """One file's part of a dataset that two files have. `rows`: where its file has the common frames.

    Of a pointer, what counts is how many rows each frame has: one more in the first would move all others.
    """

    def __init__(self, file: DriveReader, name: str, rows: np.ndarray) -> None:
        self.file, self.name, self.rows = file, name, rows
        dataset, frames = file.dataset(name), len(file.frame)
        self.shape, self.dtype = dataset.shape, dataset.dtype
        self.unit = str(dataset.attrs.get("unit", ""))
        self._whole = file[name] if dataset.size * dataset.dtype.itemsize <= _WHOLE_BYTES else None
        self._starts: np.ndarray | None = None
        if _is_pointer(name):
            self._whole = np.diff(_starts(file, name))
            self.shape = self._whole.shape
        elif self.shape[:1] != (frames,) or f"{name}_ptr" in file:
            self._starts = self._pointer()
        by_frame = self._starts is None and self.shape[:1] == (frames,)
        self.kind = "frame" if by_frame else "drive" if self._starts is None else "rows of a frame"

    def _pointer(self) -> np.ndarray | None:
        """Return where each frame's rows begin, of ragged data: its own pointer, or one that several share."""
        shared = sorted(name for name in _names(self.file) if _is_pointer(name))
        own = f"{self.name}_ptr"
        for name in [own] if own in shared else shared:
            starts = _starts(self.file, name)
            if self.shape[:1] == (starts[-1],):
                return starts
        return None

    def read(self, start: int, stop: int) -> np.ndarray:
        return self.file.rows(self.name, start, stop) if self._whole is None else self._whole[start:stop]

    def all(self) -> np.ndarray:
        return self.file[self.name] if self._whole is None else self._whole

    def of_frame(self, index: int) -> np.ndarray:
        """Return the rows that belong to the common frame number `index`."""
        row = self.rows[index]
        return self.read(row, row + 1) if self._starts is None else self.read(*self._starts[row : row + 2])


def _is_pointer(name: str) -> bool:
    return name == "ptr" or name.endswith("_ptr")


def _starts(file: DriveReader, pointer: str) -> np.ndarray:
    starts = file[pointer]
    if len(starts) != len(file.frame) + 1 or starts[0] != 0 or (np.diff(starts) < 0).any():
        raise InputError(f"{file.path} is damaged: {pointer} does not ascend from 0, one more than there are frames")
    return starts


def _form(a: _Side, b: _Side) -> str:
    """Say what differs beside the values."""
    said = [f"dtype {a.dtype} and {b.dtype}"] if a.dtype != b.dtype else []
    if a.unit != b.unit:
        said.append(f"unit {a.unit or 'none'} and {b.unit or 'none'}")
    if a.kind != b.kind:
        said.append(f"a value for each {a.kind}, and one for each {b.kind}")
    elif not _alike(a, b):
        said.append(f"shape {a.shape} and {b.shape}")
    return ", ".join(said)


def _alike(a: _Side, b: _Side) -> bool:
    """Say whether values can be compared: of frames, the number of rows may differ."""
    return a.kind == b.kind and (a.shape == b.shape if a.kind == "drive" else a.shape[1:] == b.shape[1:])


def _dataset(a: _Side, b: _Side, frames: np.ndarray, tolerance: float) -> Tally:
    found = Tally(tolerance)
    if not _alike(a, b):
        return found
    if a.kind == "drive":
        found.add(a.all(), b.all())
    elif a.kind == "rows of a frame":
        for index, frame in enumerate(frames.tolist()):
            found.add(a.of_frame(index), b.of_frame(index), frame)
    else:
        step = max(1, _WHOLE_BYTES // max(1, int(np.prod(a.shape[1:])) * a.dtype.itemsize))
        for start in range(0, len(frames), step):
            part = range(start, min(start + step, len(frames)))
            x, y = (np.concatenate([side.of_frame(index) for index in part]) for side in (a, b))
            found.add_rows(x, y, frames[start : start + step])
    return found
