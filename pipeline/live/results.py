"""The results of a run: a CSV file, a video, counts, and the folder in which they appear when it succeeds."""

import csv
import math
import os
import re
import sys
import time
from collections import Counter, deque
from collections.abc import Generator, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, contextmanager, suppress
from itertools import pairwise
from pathlib import Path
from typing import Any, TextIO

import numpy as np
from tqdm import tqdm

from pipeline.base.atomic import exclusive
from pipeline.base.errors import InputError
from pipeline.evaluate import errors
from pipeline.labels.label import Car
from pipeline.live.chain import Course, FrameState
from pipeline.live.overlay import Overlay
from pipeline.live.source import Source
from pipeline.settings.evaluate import Evaluate

STEERING, MOTION, VIDEO = "steering.csv", "motion.csv", "overlay.mp4"
TRACK, QUALITY, POSES = "track.png", "quality.json", "poses.txt"
PREDICTED_FILES, MEASURED_FILES = (STEERING, TRACK, VIDEO), (MOTION, TRACK, QUALITY, POSES, VIDEO)
FILES = {*PREDICTED_FILES, *MEASURED_FILES}
UNFINISHED = ".unfinished"
MEASURED = (
    "valid", "speed_mps", "yaw_rate_radps", "curvature_1pm", "measured_rad", "x_m", "y_m", "heading_rad",
    "speed_sigma", "measured_sigma_rad", "points", "residual",
)  # fmt: skip
"""Motion since the previous frame, left positive, empty if not `valid`; curvature and angle also at low speed.

x and y are the position ahead and to the left of the first frame. `speed_sigma` and `measured_sigma_rad` are standard
deviations, that of speed relative. `points` agree with the motion, with a median error `residual` (px; of scans m).
"""
COLUMNS = {
    STEERING: ("drive", "frame", "time_s", "predicted_rad", "driven_rad", "latency_ms", *MEASURED, "sigma_rad"),
    MOTION: ("drive", "frame", "time_s", "driven_rad", *MEASURED),
}
"""Angles in rad, left positive, empty if unknown: `predicted` for `horizon` frames later, `sigma` its
standard deviation, the others for the frame."""
KNOWN = ("frame", "time_s", "measured_rad", "measured_mps", "predicted_rad", "driven_rad", "driven_mps")
FIRST_COLUMNS = "drive,frame,time_s,"
LEFTOVER = re.compile(rf"\.({'|'.join(map(re.escape, sorted(FILES)))})\..{{8}}\.tmp")  # of a killed process
MIN_DRIVEN_MPS = 1.0  # of frames whose speeds are compared
LINE_S = 30.0  # between lines of progress without a terminal
RECENT = 2000  # frames that latency quantiles are computed from
BLOCK_S = 5.0  # errors of nearer frames are correlated
BOOTSTRAP = Evaluate(
    bootstrap_samples=2000, bootstrap_block_frames=1, curvature_bins_1pm=[1.0], path="bicycle", seed=0
)  # for the interval of nmse


def check_out(out: Path, names: Sequence[str], source: Path | None = None) -> None:
    """Raise InputError if results `names` in `out` would replace or remove a file that this program did not write.

    Raises it also if they would replace the `source`.
    """
    folder, fix = out / UNFINISHED, "Pass another folder: --out"
    for place in (out, folder):
        if (os.path.lexists(place) and not place.is_dir()) or (place == folder and folder.is_symlink()):
            raise InputError("expected a folder, got a file or a link", place, fix)
    for path in folder.iterdir() if folder.is_dir() else ():
        temporary = path.is_dir() and LEFTOVER.fullmatch(path.name)
        if path.is_symlink() or not (temporary or (path.is_file() and path.name in FILES)):
            raise InputError("expected only files of an interrupted run here", path, "Move it to another folder")
    earlier = [name for name in COLUMNS if _is_csv(out / name)]
    for name in names:
        path = out / name
        written = name in earlier if name in COLUMNS else earlier and path.is_file() and not path.is_symlink()
        if os.path.lexists(path) and not written:
            raise InputError("steer did not write this file, so it is not replaced", path, fix)
        if source and os.path.realpath(source) in (os.path.realpath(path), os.path.realpath(folder / name)):
            raise InputError("the results would replace the source", source, fix)


def _is_csv(path: Path) -> bool:
    """Return whether a path is a CSV file that this program wrote."""
    if path.is_symlink() or not path.is_file():
        return False
    with path.open("rb") as file:
        return file.read(len(FIRST_COLUMNS)) == FIRST_COLUMNS.encode()


@contextmanager
def result_folder(out: Path, *names: str) -> Iterator[Path]:
    """Yield ``out/.unfinished`` for new results `names`; they replace those in `out` when the block succeeds.

    After an error, an interrupt or a kill they stay in ``out/.unfinished`` until the next run, and `out` is unchanged.
    Raises InputError if another process writes to `out`, and as :func:`check_out`.
    """
    folder = out / UNFINISHED
    check_out(out, names)
    with exclusive(out, folder):
        check_out(out, names)
        for name in FILES:
            (folder / name).unlink(missing_ok=True)
        yield folder
        for name in names:
            if (folder / name).exists():
                (folder / name).replace(out / name)
            else:
                (out / name).unlink(missing_ok=True)  # an earlier run's, which does not belong to these results
        with suppress(OSError):  # another program may have put a file there
            folder.rmdir()


class Results:
    """Writes and counts frames in order. The first `warm_up` frames, which initialise libraries, have no latency."""

    def __init__(
        self,
        file: TextIO,
        drive: str,
        warm_up: int,
        columns: Sequence[str],
        ahead_m: Sequence[float] = (),
        uncertainty: bool = False,
    ) -> None:
        """Write the header.

        With the edges `ahead_m` of ranges of a predicted path, each range has a column, with `uncertainty` two.
        """
        self._file, self._drive, self._warm_up, self.ahead_m = file, drive, warm_up, ahead_m
        self._path_columns = [f"path_{near:g}_{far:g}m_1pm" for near, far in pairwise(ahead_m)]
        if uncertainty:
            self._path_columns += [f"{name.removesuffix('_1pm')}_sigma_1pm" for name in self._path_columns]
        columns = [*columns, *self._path_columns]
        self._rows = csv.DictWriter(file, columns, extrasaction="ignore", lineterminator="\n")
        self._rows.writeheader()
        self.frames = self.predicted = self.valid = 0
        self.problems: Counter[str] = Counter()
        self.courses: list[tuple[float, Course]] = []  # with their times in seconds
        self._known: list[tuple[float, ...]] = []  # for each frame, the values of KNOWN
        self.paths: list[tuple[Course, Sequence[float]]] = []  # predicted, the length of a path apart
        self.road_heights_m: list[float] = []
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
        self.predicted += frame.predicted_rad is not None or frame.path_1pm is not None
        self.valid += frame.course is not None
        if frame.problem:
            self.problems[frame.problem] += 1
        if frame.course:
            self.courses.append((frame.time_s, frame.course))
            if frame.path_1pm and self._farther(frame.course):
                self.paths.append((frame.course, frame.path_1pm))
        measured = (frame.course.steering_rad, frame.course.speed_mps) if frame.course else (None, None)
        known = (frame.number, frame.time_s, *measured, frame.predicted_rad, frame.driven_rad, frame.driven_mps)
        self._known.append(tuple(np.nan if value is None else value for value in known))
        self.road_heights_m.append(frame.road_height_m)
        if self.frames <= self._warm_up:
            self._started_s = time.perf_counter()
        else:
            self._latencies_s.append(frame.latency_s)
        row = {"drive": self._drive, "frame": frame.number, "time_s": f"{frame.time_s:.6f}"}
        row |= {"predicted_rad": _format(frame.predicted_rad, 6), "driven_rad": _format(frame.driven_rad, 9)}
        row |= {"latency_ms": f"{frame.latency_s * 1e3:.1f}", "sigma_rad": _format(frame.sigma_rad, 6)}
        if frame.path_1pm:
            values = [*frame.path_1pm, *(frame.path_sigma_1pm or ())]
            row |= {name: _format(value, 6) for name, value in zip(self._path_columns, values, strict=True)}
        self._rows.writerow(row | dict(zip(MEASURED, _measured(frame), strict=True)))
        self._file.flush()

    def _farther(self, course: Course) -> bool:
        """Return whether the last of `paths` ends before a course."""
        if not self.paths:
            return True
        last, _ = self.paths[-1]
        return math.hypot(course.x_m - last.x_m, course.y_m - last.y_m) > self.ahead_m[-1]

    def columns(self, *names: str) -> list[np.ndarray]:
        """Return values of all frames [N] by names of KNOWN; NaN where unknown, all of them for other names."""
        known = np.array(self._known, np.float64).reshape(-1, len(KNOWN)).T
        unknown = np.full(known.shape[1], np.nan)
        return [known[KNOWN.index(name)] if name in KNOWN else unknown for name in names]

    def summary(self) -> dict[str, Any]:
        """Return counts, gaps, latency quantiles of recent frames in ms and frames per second; NaN before the first."""
        counts = {"frames": self.frames, "predicted": self.predicted, "valid": self.valid, "gaps": self.gaps}
        if not self._latencies_s:
            return counts | dict.fromkeys(("p50_ms", "p95_ms", "hz"), float("nan"))
        p50_ms, p95_ms = (np.percentile(self._latencies_s, [50, 95]) * 1e3).tolist()
        hz = (self.frames - self._warm_up) / (time.perf_counter() - self._started_s)
        return counts | {"p50_ms": p50_ms, "p95_ms": p95_ms, "hz": hz}

    def compare(self, truth: str, column: str, horizon: int = 0) -> dict[str, Any] | None:
        """Return errors of the angles against the driven ones `horizon` frames later; None without common frames.

        Args:
            truth: source of the driven angles.
            column: predicted or measured; errors are computed on its frames. Elsewhere the measured angle repeats the
                last one, or 0.
        """
        names = "frame", "time_s", "driven_rad", "predicted_rad", "measured_rad"
        number, time_s, driven_rad, predicted_rad, measured_rad = self.columns(*names)
        driven = dict(zip(number.tolist(), driven_rad.tolist(), strict=True))
        target_rad = np.array([driven.get(frame + horizon, np.nan) for frame in number.tolist()])
        angles_rad = {"predicted": predicted_rad, "measured": measured_rad}
        used = np.isfinite(target_rad) & np.isfinite(angles_rad[column])
        if not used.any():
            return None
        rows = {column: angles_rad[column]}
        if np.isfinite(measured_rad).any():
            last = np.maximum.accumulate(np.where(np.isfinite(measured_rad), np.arange(len(number)), -1))
            rows["measured"] = np.where(last >= 0, measured_rad[last], 0.0)
        rows["zero"] = np.zeros(len(number))
        block = max(1, round(BLOCK_S / float(np.median(np.diff(time_s))))) if len(time_s) > 1 else 1
        settings = BOOTSTRAP.model_copy(update={"bootstrap_block_frames": block})
        scores = {name: _errors(target_rad[used], angle_rad[used], settings) for name, angle_rad in rows.items()}
        return {"truth": truth, "frames": int(used.sum()), "horizon": horizon, **scores}

    def speed_ratio(self) -> float | None:
        """Return the measured distance divided by the driven one, of frames with both speeds; None without any."""
        measured_mps, driven_mps = self.columns("measured_mps", "driven_mps")
        used = np.isfinite(measured_mps) & (driven_mps >= MIN_DRIVEN_MPS)
        return float(measured_mps[used].sum() / driven_mps[used].sum()) if used.any() else None

    def speed(self) -> str:
        """Return the rate as text, and the latency of predictions."""
        text = "{hz:.1f} frames/s" + (", latency p50 {p50_ms:.0f} ms, p95 {p95_ms:.0f} ms" if self.predicted else "")
        return text.format_map(self.summary())

    def lines(self, notes: Sequence[str]) -> Iterator[str]:
        """Yield text for the user: gaps, the `notes` of the source, and why motion could not be measured."""
        yield from (f"no frames between {before} and {after}" for before, after in self.gaps)
        yield from notes
        if problems := self.problems.most_common():
            reasons = ", ".join(f"{problem} ({count})" for problem, count in problems)
            yield f"motion measured in {self.valid} of {self.frames} frames; not measured: {reasons}"


def _errors(target_rad: np.ndarray, angle_rad: np.ndarray, settings: Evaluate) -> dict[str, Any]:
    """Return nmse, its 95 % interval, rmse_deg and correlation of angles [N]; None where not defined."""
    scores = errors.scores(target_rad, angle_rad)
    nmse, drive = scores["nmse"], np.zeros(len(target_rad), int)
    interval = None if nmse is None else errors.interval((angle_rad - target_rad) ** 2, target_rad, drive, settings)
    varies = np.ptp(target_rad) > 0 and np.ptp(angle_rad) > 0
    correlation = float(np.corrcoef(target_rad, angle_rad)[0, 1]) if varies else None
    return {"nmse": nmse, "nmse_ci95": interval, "rmse_deg": math.degrees(scores["rmse"]), "correlation": correlation}


def comparison_lines(comparison: Mapping[str, Any] | None) -> Iterator[str]:
    """Yield text for the user of :meth:`Results.compare`."""
    if comparison is None:
        return
    ahead = f", {comparison['horizon']} frames ahead" if comparison["horizon"] else ""
    yield f"truth from {comparison['truth']}, {comparison['frames']} frames{ahead}:"
    for name in ("predicted", "measured", "zero"):
        if row := comparison.get(name):
            nmse = "-" if row["nmse"] is None else f"{row['nmse']:.3f} ({errors.interval_text(row['nmse_ci95'])})"
            correlation = "" if row["correlation"] is None else f", correlation {row['correlation']:.3f}"
            yield f"  {name}: nmse {nmse}, RMSE {row['rmse_deg']:.2f} deg{correlation}"


def write_frames(
    frames: Generator[FrameState],
    path: Path,
    source: Source,
    car: Car,
    *,
    warm_up: int,
    video: bool,
    visible: bool,
    ahead_m: Sequence[float] = (),
    uncertainty: bool = False,
) -> Results:
    """Write `frames` of `source` to the CSV file `path`, and a video beside it; closes `frames`.

    Args:
        ahead_m: edges of the ranges of the predicted path, for models of the path.
        uncertainty: write the σ of the path, too.
        visible: show a progress bar, or without a terminal a line every LINE_S.
    Raises:
        InputError: there is no frame.
    """
    with ExitStack() as stack:
        file = stack.enter_context(path.open("w", newline="", encoding="utf-8"))
        results, overlay = Results(file, source.name, warm_up, COLUMNS[path.name], ahead_m, uncertainty), None
        if video:
            show: dict[str, Any] = {"predicts": path.name == STEERING, "ahead_m": ahead_m}
            overlay = Overlay(path.with_name(VIDEO), source, car.wheelbase_m, **show)
            stack.enter_context(overlay)
        bar = stack.enter_context(tqdm(total=source.count, unit=" frames", disable=None if visible else True))
        printed_s = time.perf_counter()
        for frame in stack.enter_context(closing(frames)):
            results.add(frame)
            if overlay:
                overlay.add(frame)
            bar.update()
            if results.frames % 20 == 0:
                bar.set_postfix_str(results.speed())
            if visible and bar.disable and time.perf_counter() - printed_s > LINE_S:
                printed_s = time.perf_counter()
                print(f"{results.frames} of {source.count or '?'} frames, {results.speed()}", file=sys.stderr)
    if not results.frames:
        raise InputError("no frame could be read", source.path, "; ".join(source.notes[:1]))
    return results


def _measured(frame: FrameState) -> list[str]:
    if frame.course is None or frame.estimate is None:
        return ["0", *[""] * (len(MEASURED) - 1)]
    step = frame.estimate.step
    return ["1", *(_format(value, 6) for value in frame.course), str(step.inliers), f"{step.residual:.3f}"]


def _format(value: float | None, digits: int) -> str:
    return "" if value is None else f"{value:.{digits}f}"
