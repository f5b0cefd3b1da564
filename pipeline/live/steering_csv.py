"""What a live run writes and counts: a row for each frame, whole whatever comes after it."""

import csv
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TextIO

from pipeline.live.latency import Latency
from pipeline.live.moment import Moment

COLUMNS = ("drive", "frame", "time_s", "predicted_rad", "driven_rad", "latency_ms")
"""Angles in rad, left +, empty where unknown: predicted is that of `horizon` frames later, driven that of the frame."""


class SteeringCsv:
    """Writes frames in their order. `warm_up` frames do not count in the latency."""

    def __init__(self, file: TextIO, drive: str, warm_up: int) -> None:
        self._file, self._drive = file, drive
        self._rows = csv.writer(file, lineterminator="\n")
        self._rows.writerow(COLUMNS)
        self.frames = self.predicted = 0
        self.gaps: list[tuple[int, int]] = []  # numbers of the frames around each
        self.latency = Latency(warm_up)
        self._last: int | None = None

    def add(self, moment: Moment) -> None:
        """Write a frame's row."""
        if self._last is not None and moment.number != self._last + 1:
            self.gaps.append((self._last, moment.number))
        self._last = moment.number
        self.frames += 1
        self.predicted += moment.predicted_rad is not None
        self.latency.note(moment.latency_s)
        angles = [_angle(moment.predicted_rad, 6), _angle(moment.driven_rad, 9)]
        self._rows.writerow(
            [self._drive, moment.number, f"{moment.time_s:.6f}", *angles, f"{moment.latency_s * 1e3:.1f}"]
        )
        self._file.flush()

    def summary(self) -> dict[str, Any]:
        """Return what was counted, for machines."""
        counts = {"frames": self.frames, "predicted": self.predicted, "gaps": self.gaps}
        return counts | self.latency.summary()._asdict()


@contextmanager
def writing(path: Path, drive: str, warm_up: int) -> Iterator[SteeringCsv]:
    """Open a file for the frames of a drive."""
    with path.open("w", newline="", encoding="utf-8") as file:
        yield SteeringCsv(file, drive, warm_up)


def _angle(rad: float | None, digits: int) -> str:
    return "" if rad is None else f"{rad:.{digits}f}"
