"""What is said where two artefacts differ, and when two arrays of numbers do."""

from dataclasses import dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Difference:
    """One place, in one file, at which two artefacts differ."""

    file: str  # below the folders that are compared
    where: str  # dataset, key, column, tensor; "" for the file itself
    how: str  # in words: what there is to say beside the numbers, "" if those say it
    drive: str | None = None
    count: int = 0  # values that differ, …
    total: int = 0  # … of so many
    largest: float | None = None  # difference of two numbers; None where a number meets none, or text
    frames: int = 0  # frames that differ
    first_frame: int | None = None
    largest_frame: int | None = None
    resized: int = 0  # frames that have another number of rows
    unit: str = ""

    def __str__(self) -> str:
        said = [self.how] if self.how else []
        if self.count:
            said.append(f"{self.count} of {self.total} values")
        if self.frames:
            said.append(f"in {self.frames} frame{'s' * (self.frames > 1)}, first {self.first_frame}")
        if self.resized:
            said.append(f"another number of rows in {self.resized} of them")
        if self.largest is not None:
            at = "" if self.largest_frame is None or self.frames == 1 else f" in frame {self.largest_frame}"
            unit = self.unit.partition(",")[0]  # as "rad, left positive"
            said.append(f"largest difference {self.largest:.6g}{' ' * bool(unit)}{unit}{at}")
        drive = self.drive if self.drive and self.drive not in self.file else ""
        return ": ".join(filter(None, [self.file, drive, self.where, ", ".join(said)]))


class Tally:
    """Collects what differs between pairs of arrays, part after part."""

    def __init__(self, tolerance: float) -> None:
        self._tolerance = tolerance
        self.count = self.total = self.resized = 0
        self.largest: float | None = None
        self.largest_frame: int | None = None
        self.frames: list[int] = []

    def add(self, a: np.ndarray, b: np.ndarray, frame: int | None = None) -> None:
        """Compare two arrays, all of `frame` if it is given. Of two shapes, nothing but that is said."""
        if a.shape != b.shape:
            self.resized += 1
            if frame is not None:
                self.frames.append(frame)
            return
        off = apart(a, b, self._tolerance)
        self.total += off.size
        if not off.any():
            return
        self.count += int(off.sum())
        if frame is not None:
            self.frames.append(frame)
        if a.dtype.kind in "iufb":
            largest = np.abs(a[off].astype(np.float64) - b[off].astype(np.float64))
            known = largest[~np.isnan(largest)]
            if known.size and (self.largest is None or known.max() > self.largest):
                self.largest, self.largest_frame = float(known.max()), frame

    def add_rows(self, a: np.ndarray, b: np.ndarray, frames: np.ndarray) -> None:
        """Compare two arrays [F, …] of `frames` [F]."""
        if not a.size:
            return
        rows = np.flatnonzero(apart(a, b, self._tolerance).reshape(len(a), -1).any(axis=1))
        for row in rows:
            self.add(a[row], b[row], int(frames[row]))
        self.total += a.size // len(a) * (len(a) - len(rows))

    def difference(self, file: str, where: str, how: str = "", **more: Any) -> Difference | None:
        """Return what was found; None if nothing was, and there is nothing to say beside."""
        if not (self.count or self.frames or how):
            return None
        return Difference(
            file=file, where=where, how=how, count=self.count, total=self.total, largest=self.largest,
            frames=len(self.frames), first_frame=min(self.frames, default=None),
            largest_frame=self.largest_frame, resized=self.resized, **more,
        )  # fmt: skip


def apart(a: np.ndarray, b: np.ndarray, tolerance: float) -> np.ndarray:
    """Return where two arrays of one shape differ by more than `tolerance`; NaN is NaN's equal, and no number's."""
    if a.dtype.kind not in "iufb" or b.dtype.kind not in "iufb":
        return np.asarray(a != b)
    if "f" not in (a.dtype.kind, b.dtype.kind) and tolerance < 1:
        return np.asarray(a != b)
    x, y = a.astype(np.float64), b.astype(np.float64)
    with np.errstate(invalid="ignore"):  # infinity minus itself
        near = (np.abs(x - y) <= tolerance) | (x == y)
    return ~(near | (np.isnan(x) & np.isnan(y)))
