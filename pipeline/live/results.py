"""The results of a run: a CSV file, counts, latency, and the folder in which they appear when it succeeds."""

import csv
import time
from collections import Counter, deque
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TextIO

import numpy as np

from pipeline.base.atomic import exclusive
from pipeline.live.frame_state import FrameState

STEERING, MOTION, VIDEO = "steering.csv", "motion.csv", "overlay.mp4"
TRACK, QUALITY = "track.png", "quality.json"
UNFINISHED = ".unfinished"
MEASURED = (
    "valid", "speed_mps", "yaw_rate_radps", "curvature_1pm", "measured_rad", "x_m", "y_m", "heading_rad", "points",
    "residual",
)  # fmt: skip
"""Motion since the previous frame, left positive, empty if not `valid`; curvature and angle also at low speed.

x and y are the position ahead and to the left of the first frame. `points` agree with the motion, with a median error
`residual` (px; of scans m).
"""
COLUMNS = {
    STEERING: ("drive", "frame", "time_s", "predicted_rad", "driven_rad", "latency_ms", *MEASURED, "sigma_rad"),
    MOTION: ("drive", "frame", "time_s", "driven_rad", *MEASURED),
}
"""Angles in rad, left positive, empty if unknown: `predicted` for `horizon` frames later, `sigma` its
standard deviation, the others for the frame."""
RECENT = 2000  # frames that latency quantiles are computed from


@contextmanager
def result_folder(out: Path, *names: str) -> Iterator[Path]:
    """Yield ``out/.unfinished`` for new results `names`; they replace those in `out` when the block succeeds.

    After an error, an interrupt or a kill they stay in ``out/.unfinished`` until the next run, and `out` is unchanged.
    Raises InputError if another process writes to `out`.
    """
    folder = out / UNFINISHED
    with exclusive(out, folder):
        for name in names:
            (folder / name).unlink(missing_ok=True)
        yield folder
        for name in names:
            if (folder / name).exists():
                (folder / name).replace(out / name)
            else:
                (out / name).unlink(missing_ok=True)  # an earlier run's, which does not belong to these results
        folder.rmdir()


class Results:
    """Writes and counts frames in order. The first `warm_up` frames, which initialise libraries, have no latency."""

    def __init__(self, file: TextIO, drive: str, warm_up: int, columns: Sequence[str]) -> None:
        self._file, self._drive, self._warm_up = file, drive, warm_up
        self._rows = csv.DictWriter(file, columns, extrasaction="ignore", lineterminator="\n")
        self._rows.writeheader()
        self.frames = self.predicted = self.valid = 0
        self.problems: Counter[str] = Counter()
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
        self.valid += frame.course is not None
        if frame.problem:
            self.problems[frame.problem] += 1
        if self.frames <= self._warm_up:
            self._started_s = time.perf_counter()
        else:
            self._latencies_s.append(frame.latency_s)
        row = {"drive": self._drive, "frame": frame.number, "time_s": f"{frame.time_s:.6f}"}
        row |= {"predicted_rad": _format(frame.predicted_rad, 6), "driven_rad": _format(frame.driven_rad, 9)}
        row |= {"latency_ms": f"{frame.latency_s * 1e3:.1f}", "sigma_rad": _format(frame.sigma_rad, 6)}
        self._rows.writerow(row | dict(zip(MEASURED, _measured(frame), strict=True)))
        self._file.flush()

    def summary(self) -> dict[str, Any]:
        """Return counts, gaps, latency quantiles of recent frames in ms and frames per second; NaN before the first."""
        counts = {"frames": self.frames, "predicted": self.predicted, "valid": self.valid, "gaps": self.gaps}
        if not self._latencies_s:
            return counts | dict.fromkeys(("p50_ms", "p95_ms", "hz"), float("nan"))
        p50_ms, p95_ms = (np.percentile(self._latencies_s, [50, 95]) * 1e3).tolist()
        hz = (self.frames - self._warm_up) / (time.perf_counter() - self._started_s)
        return counts | {"p50_ms": p50_ms, "p95_ms": p95_ms, "hz": hz}

    def speed(self) -> str:
        """Return latency and rate as text."""
        return "{hz:.1f} Hz, latency p50 {p50_ms:.0f} ms, p95 {p95_ms:.0f} ms".format_map(self.summary())


def _measured(frame: FrameState) -> list[str]:
    if frame.course is None or frame.estimate is None:
        return ["0", *[""] * (len(MEASURED) - 1)]
    step = frame.estimate.step
    return ["1", *(_format(value, 6) for value in frame.course), str(step.inliers), f"{step.residual:.3f}"]


def _format(value: float | None, digits: int) -> str:
    return "" if value is None else f"{value:.{digits}f}"
