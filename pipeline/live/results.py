"""The results of a run: steering.csv, counts, latency, and the folder in which they appear when it succeeds."""

import csv
import time
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TextIO

import numpy as np

from pipeline.base.lock import exclusive
from pipeline.live.frame_state import FrameState

CSV, VIDEO = "steering.csv", "overlay.mp4"
UNFINISHED = ".unfinished"
COLUMNS = ("drive", "frame", "time_s", "predicted_rad", "driven_rad", "latency_ms")
"""Angles in rad, left positive, empty if unknown: `predicted` for `horizon` frames later, `driven` for the frame."""
RECENT = 2000  # frames that latency quantiles are computed from


@contextmanager
def result_folder(out: Path) -> Iterator[Path]:
    """Yield ``out/.unfinished`` for new results; they replace those in `out` when the block succeeds.

    After an error, an interrupt or a kill they stay in ``out/.unfinished`` until the next run, and `out` is unchanged.
    Raises InputError if another process writes to `out`.
    """
    folder = out / UNFINISHED
    with exclusive(out, folder):
        for name in (CSV, VIDEO):
            (folder / name).unlink(missing_ok=True)
        yield folder
        for name in (VIDEO, CSV):
            if (folder / name).exists():
                (folder / name).replace(out / name)
            else:
                (out / name).unlink(missing_ok=True)  # an earlier run's, which does not belong to these results
        folder.rmdir()


class Results:
    """Writes and counts frames in order. The first `warm_up` frames, which initialise libraries, have no latency."""

    def __init__(self, file: TextIO, drive: str, warm_up: int) -> None:
        self._file, self._drive, self._warm_up = file, drive, warm_up
        self._rows = csv.writer(file, lineterminator="\n")
        self._rows.writerow(COLUMNS)
        self.frames = self.predicted = 0
        self.gaps: list[tuple[int, int]] = []  # numbers of the frames before and after each
        self._last: int | None = None
        self._latencies_s: deque[float] = deque(maxlen=RECENT)
        self._started_s = time.perf_counter()

    def add(self, frame: FrameState) -> None:
        """Write the row of a frame."""
        if self._last is not None and frame.number != self._last + 1:
            self.gaps.append((self._last, frame.number))
        self._last = frame.number
        self.frames += 1
        self.predicted += frame.predicted_rad is not None
        if self.frames <= self._warm_up:
            self._started_s = time.perf_counter()
        else:
            self._latencies_s.append(frame.latency_s)
        angles = [_format(frame.predicted_rad, 6), _format(frame.driven_rad, 9)]
        latency_ms = f"{frame.latency_s * 1e3:.1f}"
        self._rows.writerow([self._drive, frame.number, f"{frame.time_s:.6f}", *angles, latency_ms])
        self._file.flush()

    def summary(self) -> dict[str, Any]:
        """Return counts, gaps, latency quantiles of recent frames in ms and frames per second; NaN before the first."""
        counts = {"frames": self.frames, "predicted": self.predicted, "gaps": self.gaps}
        if not self._latencies_s:
            return counts | dict.fromkeys(("p50_ms", "p95_ms", "hz"), float("nan"))
        p50_ms, p95_ms = (np.percentile(self._latencies_s, [50, 95]) * 1e3).tolist()
        hz = (self.frames - self._warm_up) / (time.perf_counter() - self._started_s)
        return counts | {"p50_ms": p50_ms, "p95_ms": p95_ms, "hz": hz}

    def speed(self) -> str:
        """Return latency and rate as text."""
        return "{hz:.1f} Hz, latency p50 {p50_ms:.0f} ms, p95 {p95_ms:.0f} ms".format_map(self.summary())


def _format(rad: float | None, digits: int) -> str:
    return "" if rad is None else f"{rad:.{digits}f}"
