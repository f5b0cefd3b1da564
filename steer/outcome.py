"""Collect the results of a run: the course of the car, ground truth, and errors of angles."""

import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from pipeline.base.console import split_doubts
from pipeline.base.errors import InputError
from pipeline.base.store import DriveReader
from pipeline.evaluate import statistics
from pipeline.evaluate.settings import Evaluate
from pipeline.ingest.log import Logs, log_names, log_notes
from pipeline.labels.ahead import path_ahead
from pipeline.labels.label import Car, Labels, steering_angle, steering_labels
from pipeline.labels.recorded import Recorded, compare
from pipeline.labels.source import rates_of_motion, recorded_angles, recorded_rates
from pipeline.motion import rates
from pipeline.motion.facts import facts_line
from pipeline.motion.step import PROBLEMS
from pipeline.train.quantity import Quantity
from steer.chain import INGEST, MOTION, Source

# Longest gap in seconds over which the track continues with the last measured motion.
BRIDGED_S = 1.0
# Length in seconds of a block of the bootstrap: errors of nearer frames are correlated.
BLOCK_S = 5.0
# Longest time in seconds for which the car may stand on the path that is drawn.
MAX_STAND_S = 5.0
# Formats of columns in a CSV file; other columns have ".6f".
FORMATS = {"frame": ".0f", "valid": ".0f", "points": ".0f", "residual": ".3f", "driven_rad": ".9f"}


class Outcome(NamedTuple):
    """The results for a caller of :mod:`steer.api`."""

    # A row per frame, as in motion.csv or steering.csv; NaN where unknown.
    table: pd.DataFrame
    notes: list[str]
    doubts: list[str]
    files: list[Path]


class Truth(NamedTuple):
    """The ground truth of F frames."""

    # The file or sensor that recorded it; empty without ground truth.
    name: str
    driven: Labels


def read_truth(ingest: DriveReader, frame: np.ndarray, logs: Logs, car: Car) -> Truth:
    """Return the ground truth for frame numbers [F] of an ingest file.

    The file has the values of `logs`. If there are two logs, the angle is the wheel's. A drive
    without logs may have oxts or a file of recorded angles. If it has both, the angle follows from
    oxts.
    """
    recorded = recorded_rates(ingest)
    angles = recorded_angles(ingest, recorded, car)
    unknown = np.full(len(ingest.frame), np.nan)
    rows = np.searchsorted(ingest.frame, frame)

    if angles and ("wheel" in logs or not recorded):
        # The track follows from a recorded yaw rate, never from a recorded angle.
        yaw_rate_radps = recorded.yaw_rate_radps if recorded else unknown
        driven = angles._replace(yaw_rate_radps=yaw_rate_radps).at(rows)
        return Truth(log_names(logs) or "steering.csv", driven)
    if recorded:
        driven = steering_labels(recorded.yaw_rate_radps, recorded.speed_mps, car).at(rows)
        return Truth(log_names(logs) or "oxts", driven)
    return Truth("", steering_labels(unknown, unknown, car).at(rows))


def read_course(motion: DriveReader, car: Car, *, smooth: bool) -> dict[str, np.ndarray]:
    """Return the course of the car from a file of stage motion: column → [F], NaN if not measured.

    Left and forward are positive. x and y are the position ahead and to the left of the first
    frame. ``speed_sigma`` is the standard deviation of the speed, relative to the speed;
    ``measured_sigma_rad`` is that of the angle. Curvature and angle are also NaN below the minimum
    speed. If `smooth` is true, rates depend on later frames, too.
    """
    yaw_rate, speed_mps, yaw_sigma, speed_sigma = rates.read_rates(motion, smooth=smooth)

    # Curvature and angle follow from the bicycle model, which needs a moving car.
    is_fast = np.abs(np.nan_to_num(speed_mps)) >= car.min_speed_mps
    fast_mps = np.where(is_fast, speed_mps, np.nan)
    curvature = yaw_rate / fast_mps
    angle = steering_angle(yaw_rate, fast_mps, car.wheelbase_m)
    curvature_sigma = np.hypot(yaw_sigma / fast_mps, curvature * speed_sigma)
    angle_sigma = curvature_sigma * car.wheelbase_m * np.cos(angle) ** 2

    # In a short gap, the car continues with the last measured motion, unless it has stood since.
    # For each row, find the latest row in which the motion was measured, and in which the car
    # stood; -1 if there is none yet.
    time_s = motion.time_s
    valid = motion["valid"].astype(bool)
    rows = np.arange(len(time_s))
    measured_row = np.maximum.accumulate(np.where(valid, rows, -1))
    standing_row = np.maximum.accumulate(np.where(rates.stands(motion), rows, -1))
    is_recent = time_s - time_s[measured_row] <= BRIDGED_S
    moves = (measured_row >= 0) & (standing_row <= measured_row) & is_recent

    held_mps = np.where(moves, speed_mps[measured_row], 0.0)
    held_radps = np.where(moves, yaw_rate[measured_row], 0.0)
    place_m, heading_rad = integrate_motion(time_s, held_mps, held_radps)
    return {
        "speed_mps": speed_mps,
        "yaw_rate_radps": yaw_rate,
        "curvature_1pm": curvature,
        "measured_rad": angle,
        "x_m": np.where(valid, place_m.real, np.nan),
        "y_m": np.where(valid, place_m.imag, np.nan),
        "heading_rad": np.where(valid, heading_rad, np.nan),
        "speed_sigma": speed_sigma,
        "measured_sigma_rad": angle_sigma,
    }


def integrate_motion(
    time_s: np.ndarray, speed_mps: np.ndarray, yaw_rate_radps: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return places, complex numbers [F] of metres ahead + left i, and headings [F] in rad.

    The rates [F] of a frame are those of the step that ends there.
    """
    step_s = np.diff(time_s, prepend=time_s[:1])
    turned_rad = yaw_rate_radps * step_s
    heading_rad = np.cumsum(turned_rad)
    # Each step has the mean heading of its two ends.
    place_m = np.cumsum(speed_mps * step_s * np.exp(1j * (heading_rad - turned_rad / 2)))
    return place_m, heading_rad


@dataclass
class Results:
    """The results of F frames, and their ground truth."""

    # Name of the source.
    name: str
    # Column → [F], NaN where unknown; angles in rad, left positive.
    table: dict[str, np.ndarray]
    # Reason why the motion of each frame is not measured; empty where it is.
    problems: list[str]
    truth: Truth
    # Labels by the measured motion, which later frames smooth.
    measured: Labels
    # Quantity → facts about the recorded values beside the measured ones.
    recorded: dict[str, dict[str, Any]]
    # Lines of facts about the motion and the recorded values, and those with a doubt.
    facts: list[str]
    doubts: list[str]
    # Edges in metres of the ranges of the predicted path; empty unless a path ahead is predicted.
    edges_m: Sequence[float] = ()
    # Predicted mean curvature in each range, [F,R].
    path_1pm: np.ndarray | None = None
    # Mean curvature in each range of the path that the car took, [F,R]; NaN where unknown. It is
    # the driven one by a log with speeds, otherwise the measured one.
    taken_1pm: dict[str, np.ndarray] = field(default_factory=dict)
    # Content of quality.json.
    quality: dict[str, Any] | None = None

    @classmethod
    def read(
        cls,
        source: Source,
        work: Path,
        car: Car,
        *,
        smooth: bool,
        frame: np.ndarray | None = None,
    ) -> "Results":
        """Return the measured motion that :func:`steer.chain.run_chain` wrote to `work`.

        Columns are frame, time_s, driven_rad, valid, those of :func:`read_course`, points and
        residual. ``points`` is the number of points that agree with the motion, and ``residual``
        their median error in pixels. `frame` has the numbers of the frames to return, of which
        those without a row in the file of motion are left out. If it is None, all frames are
        returned. Raises InputError if there is no frame.
        """
        with (
            DriveReader(work / MOTION, stage="motion") as motion,
            DriveReader(work / INGEST, stage="ingest") as raw,
        ):
            if frame is None:
                frame = motion.frame
            rows = np.flatnonzero(np.isin(motion.frame, frame))
            if not len(rows):
                note = "; ".join(source.drive.notes[:1])
                raise InputError("no frame could be read", source.path, note)
            frame = motion.frame[rows]
            time_s = motion.time_s[rows]
            truth = read_truth(raw, frame, source.logs, car)

            course = read_course(motion, car, smooth=smooth)
            valid = motion["valid"]
            columns = {"valid": valid, **course}
            columns["points"] = np.where(valid, motion["inliers"], np.nan)
            columns["residual"] = np.where(valid, motion["residual"], np.nan)
            problems = [PROBLEMS[code] for code in motion["problem"][rows]]

            # The motion as stage labels would measure it.
            ingest_rows = np.searchsorted(raw.frame, frame)
            measured_rates = rates_of_motion(raw, work / MOTION)
            measured = steering_labels(
                measured_rates.yaw_rate_radps, measured_rates.speed_mps, car
            ).at(ingest_rows)
            recorded = Recorded.read(raw, motion, car)
            source.drive.notes.extend(log_notes(source.logs, time_s))

            motion_facts = facts_line(source.name, [motion.attrs])

        measured_columns = {name: values[rows] for name, values in columns.items()}
        table = {"frame": frame, "time_s": time_s}
        table["driven_rad"] = np.where(truth.driven.valid, truth.driven.steering_rad, np.nan)
        table |= measured_columns
        recorded_facts = compare([recorded], _log_of_quantity(source.logs))
        lines = [motion_facts, *[facts["line"] for facts in recorded_facts.values()]]
        notes, doubts = split_doubts(lines)
        doubts = [*source.doubts, *doubts]
        return cls(source.name, table, problems, truth, measured, recorded_facts, notes, doubts)

    def add_prediction(self, quantity: Quantity, values: np.ndarray) -> None:
        """Add the predicted values [F,R] of a quantity.

        They become the columns ``predicted_COLUMN``, and their angle ``predicted_rad``. If they lie
        ahead of the car, the path that the car took is added, too.
        """
        self.table["predicted_rad"] = quantity.angle_rad(values)
        for name, column in zip(quantity.columns, values.T, strict=True):
            self.table[f"predicted_{name}"] = column
        if quantity.is_ahead:
            self._add_path(quantity.edges_m, quantity.curvature(values))

    def _add_path(self, edges_m: Sequence[float], path_1pm: np.ndarray) -> None:
        """Add a predicted path [F,R] with edges [R+1], and the path that the car took."""
        self.edges_m = edges_m
        self.path_1pm = path_1pm
        name = "measured"
        labels = self.measured
        if np.isfinite(self.truth.driven.speed_mps).any():
            name = "driven"
            labels = self.truth.driven
        curvature_1pm, valid = path_ahead(
            self.table["frame"], self.table["time_s"], labels, edges_m, MAX_STAND_S
        )
        self.taken_1pm = {name: np.where(valid, curvature_1pm, np.nan)}

    def columns(self) -> pd.DataFrame:
        """Return a row per frame, with the name of the drive and the columns of ``table``."""
        return pd.DataFrame({"drive": self.name, **self.table})

    def write_csv(self, path: Path) -> None:
        """Write the table of :meth:`columns`. Cells of unknown values are empty."""
        table = self.columns()
        for name in table.columns[1:]:
            number_format = FORMATS.get(name, ".6f")
            to_text = f"{{:{number_format}}}".format
            table[name] = table[name].map(to_text, na_action="ignore")
        table.to_csv(path, index=False)

    def lines(self, comparison: Mapping[str, Any] | None) -> Iterator[str]:
        """Yield notes for the user: why motion was not measured, and errors by :meth:`compare`."""
        yield from self.facts
        counts = Counter(problem for problem in self.problems if problem).most_common()
        if counts:
            reasons = ", ".join(f"{problem} ({count})" for problem, count in counts)
            yield f"frames without a measurement: {reasons}"

        if comparison is None:
            return
        line = f"truth from {comparison['truth']}, {comparison['frames']} frames"
        if comparison["horizon"]:
            line += f", {comparison['horizon']} frames ahead"
        yield f"{line}:"
        for name in ("predicted", "measured", "zero"):
            if name in comparison:
                yield f"  {name}: {_errors_text(comparison[name])}"

    def compare(self, column: str, horizon: int = 0) -> dict[str, Any] | None:
        """Return errors of angles against the truth `horizon` frames later.

        `column` is predicted or measured. Errors are computed on the frames that have a truth and a
        value of `column`. Returns None if there are no such frames.
        """
        frame = self.table["frame"]
        time_s = self.table["time_s"]
        driven_rad = pd.Series(self.table["driven_rad"], frame)
        target_rad = driven_rad.reindex(frame + horizon).to_numpy(copy=True)
        used = np.isfinite(target_rad) & np.isfinite(self.table[f"{column}_rad"])
        if not used.any():
            return None
        target_rad[~used] = np.nan

        # Measured angles are a baseline on all of these frames: where none is measured, the last
        # one is repeated. Before the first, the baseline is 0.
        held_rad = pd.Series(self.table["measured_rad"]).ffill().fillna(0.0).to_numpy()
        angles = {"measured": held_rad, "zero": np.zeros(len(frame))}
        if column == "predicted":
            angles[column] = self.table["predicted_rad"]

        block = 1
        if len(time_s) > 1:
            step_s = float(np.median(np.diff(time_s)))
            block = max(1, round(BLOCK_S / step_s))
        settings = Evaluate(bootstrap_samples=2000, bootstrap_block_frames=block, seed=0)
        errors = {name: _errors(target_rad, angle, settings) for name, angle in angles.items()}
        return {"truth": self.truth.name, "frames": int(used.sum()), "horizon": horizon, **errors}


def _log_of_quantity(logs: Logs) -> dict[str, str]:
    """Return quantity → name of the file or sensor that recorded it."""
    motion = logs["motion"].name if "motion" in logs else "oxts"
    wheel = logs["wheel"].name if "wheel" in logs else "steering.csv"
    return {"yaw_rate": motion, "speed": motion, "angle": wheel}


def _errors(target_rad: np.ndarray, angle_rad: np.ndarray, settings: Evaluate) -> dict[str, Any]:
    """Return nmse, its 95 % interval, rmse_deg and correlation of angles [N]; None if undefined.

    Frames whose target is NaN do not count.
    """
    # The interval is computed only if there are enough blocks of frames.
    counted = np.isfinite(target_rad)
    drive = np.zeros(len(target_rad), int)
    blocks = np.unique(statistics.parts(drive, settings.bootstrap_block_frames)[counted])
    bounds = None
    if len(blocks) >= statistics.LEAST_DRIVES:
        error = (angle_rad - target_rad)[None] ** 2
        bounds = statistics.interval(error, target_rad, drive, settings)

    target_rad = target_rad[counted]
    angle_rad = angle_rad[counted]
    scores = statistics.scores(target_rad, angle_rad)
    correlation = None
    if np.ptp(target_rad) > 0 and np.ptp(angle_rad) > 0:
        correlation = float(np.corrcoef(target_rad, angle_rad)[0, 1])
    return {
        "nmse": scores["nmse"],
        "nmse_ci95": bounds,
        "rmse_deg": math.degrees(scores["rmse"]),
        "correlation": correlation,
    }


def _errors_text(errors: Mapping[str, Any]) -> str:
    """Return the errors of :func:`_errors` as a line for the user."""
    nmse = "-"
    if errors["nmse"] is not None:
        nmse = f"{errors['nmse']:.3f} ({statistics.interval_text(errors['nmse_ci95'])})"
    text = f"nmse {nmse}, RMSE {errors['rmse_deg']:.2f} deg"
    if errors["correlation"] is not None:
        text += f", correlation {errors['correlation']:.3f}"
    return text
