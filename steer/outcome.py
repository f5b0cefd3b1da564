"""Results of a run, frame by frame: the car's course, what was driven, a CSV file, and errors of
angles.
"""

import math
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from pipeline.base.errors import InputError
from pipeline.base.store import DriveReader
from pipeline.evaluate import statistics
from pipeline.evaluate.settings import Evaluate
from pipeline.ingest.log import Logs, log_names, log_notes
from pipeline.labels import source as sources
from pipeline.labels.agreement import Agreement, Pair, compare
from pipeline.labels.comparison import judge, read_noise
from pipeline.labels.label import Car, Labels, steering_angle, steering_labels
from pipeline.motion import rates
from pipeline.motion.doubts import find_doubts
from pipeline.motion.step import PROBLEMS
from steer.chain import INGEST, MOTION, Source

BACKWARDS = 0.5  # share of the moving frames: beyond, the camera looks back
BRIDGED_S = 1.0  # longest gap over which the track continues with the last motion
# relative standard deviation of the speed if the camera's height over the road is unknown
HEIGHT_SCALE = 0.2
BLOCK_S = 5.0  # errors of nearer frames are correlated, for the interval of nmse
# others: ".6f"
FORMATS = {"frame": ".0f", "valid": ".0f", "points": ".0f", "residual": ".3f", "driven_rad": ".9f"}


class Outcome(NamedTuple):
    """What measuring or predicting a drive gives."""

    table: pd.DataFrame  # a row per frame, as in motion.csv or steering.csv; NaN where unknown
    notes: list[str]
    doubts: list[str]
    files: list[Path]


class Truth(NamedTuple):
    """Ground truth of F frames, its source, and the column of recorded angles."""

    name: str  # of the source; empty: no ground truth
    column: str  # empty: angles follow from yaw rate and speed
    driven: Labels
    ratio: float = 1.0  # of values in the log to these


def read_truth(ingest: DriveReader, frame: np.ndarray, logs: Logs, car: Car) -> Truth:
    """Return the truth for frame numbers [F] of an ingest file, which has the values of `logs`, if
    there are any.

    With two logs the angle is the wheel's; in a drive with oxts, theirs.
    """
    recorded = sources.recorded_labels(ingest, car)
    if not recorded.keys() & {"recorded", "wheel"}:
        unknown = np.full(len(frame), np.nan)
        return Truth("", "", steering_labels(unknown, unknown, car))
    source = next(
        (
            name
            for name in ("wheel", "recorded")[:: 1 if "wheel" in logs else -1]
            if name in recorded
        ),
        "",
    )
    name = log_names(logs) or {"wheel": "steering.csv", "recorded": "oxts"}[source]
    column = "wheel_rad" if "wheel" in logs else sources.angle_column(source)
    driven = recorded[source].at(np.searchsorted(ingest.frame, frame))
    return Truth(name, column, driven, logs["wheel"].ratio if "wheel" in logs else 1.0)


def read_course(
    motion: DriveReader, car: Car, *, look_ahead: bool, height_known: bool
) -> dict[str, np.ndarray]:
    """Return the course by a file of stage motion: column → [F], left and forward positive, NaN if
    not measured.

    x and y are the position ahead and to the left of the first frame. ``speed_sigma`` and
    ``measured_sigma_rad`` are standard deviations, that of the speed relative. Curvature and angle
    are also NaN below the minimum speed. `look_ahead`: as of
    :func:`pipeline.motion.rates.measured_rates`; `height_known`: of the camera over the road.
    """
    valid, time_s, rows = motion["valid"].astype(bool), motion.time_s, np.arange(len(motion.time_s))
    yaw_rate, speed_mps, yaw_sigma, speed_sigma = rates.measured_rates(
        motion, look_ahead=look_ahead
    )
    speed_sigma = np.hypot(speed_sigma, 0.0 if height_known else HEIGHT_SCALE)
    fast_mps = np.where(np.abs(np.nan_to_num(speed_mps)) >= car.min_speed_mps, speed_mps, np.nan)
    curvature, angle = yaw_rate / fast_mps, steering_angle(yaw_rate, fast_mps, car.wheelbase_m)
    angle_sigma = (
        np.hypot(yaw_sigma / fast_mps, curvature * speed_sigma)
        * car.wheelbase_m
        * np.cos(angle) ** 2
    )
    last, stood = (
        np.maximum.accumulate(np.where(mask, rows, -1)) for mask in (valid, rates.stands(motion))
    )
    moves = (last >= 0) & (stood <= last) & (time_s - time_s[last] <= BRIDGED_S)  # also in gaps
    step_s = np.diff(time_s, prepend=time_s[:1])
    turned = np.where(moves, yaw_rate[last], 0.0) * step_s
    heading_rad = np.cumsum(turned)
    place_m = np.cumsum(
        np.where(moves, speed_mps[last], 0.0) * step_s * np.exp(1j * (heading_rad - turned / 2))
    )
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


@dataclass
class Results:
    """Columns of F frames, NaN where unknown, and what was driven."""

    name: str  # of the recording
    table: dict[str, np.ndarray]  # column → [F]; angles in rad, left positive
    problems: list[str]  # why the motion of each frame is not measured; empty where it is
    truth: Truth
    agreement: Agreement  # of what was driven with the measured motion
    agreement_lines: list[str]  # at most one
    doubts: list[str]
    # edges of the ranges of the predicted path, of models of the path
    ahead_m: tuple[float, ...] = ()
    path_1pm: np.ndarray | None = None  # [F,R] predicted mean curvature in each range
    quality: dict[str, Any] | None = None  # content of quality.json

    @classmethod
    def read(
        cls,
        source: Source,
        work: Path,
        car: Car,
        *,
        look_ahead: bool,
        frame: np.ndarray | None = None,
    ) -> "Results":
        """Return the measured motion of the files that :func:`steer.chain.run_chain` wrote to
        `work`.

        Columns: frame, time_s, driven_rad, valid, those of :func:`read_course`, and the points that
        agree with the motion, with their median error `residual` in px. `frame`: numbers of the
        frames in the results, if their motion is in the files; None: all. Raises InputError if
        there is no frame, or a log says that the camera looks back.
        """
        with (
            DriveReader(work / MOTION, stage="motion") as motion,
            DriveReader(work / INGEST, stage="ingest") as raw,
        ):
            rows = np.flatnonzero(np.isin(motion.frame, motion.frame if frame is None else frame))
            if not len(rows):
                raise InputError(
                    "no frame could be read", source.path, "; ".join(source.drive.notes[:1])
                )
            frame, time_s, valid = motion.frame[rows], motion.time_s[rows], motion["valid"]
            course = read_course(
                motion, car, look_ahead=look_ahead, height_known=source.camera.height_known
            )
            truth = read_truth(raw, frame, source.logs, car)
            ingest_rows = np.searchsorted(raw.frame, frame)
            measured = sources.make_labels("visual", raw, work / MOTION, car).at(ingest_rows)
            noise = read_noise(raw, work / MOTION).at(ingest_rows)
            agreement = compare([Pair(time_s, truth.driven, measured, noise)])
            source.drive.notes.extend(log_notes(source.logs, time_s))
            doubts = [
                *source.doubts,
                *_backwards(source.path, course["speed_mps"][rows], truth, car.min_speed_mps),
            ]
            doubts += [text for _, text in find_doubts(motion.attrs)]
            points, residual = (
                np.where(valid, motion[name], np.nan) for name in ("inliers", "residual")
            )
            problems = [PROBLEMS[code] for code in motion["problem"][rows]]
        columns = {"valid": valid, **course, "points": points, "residual": residual}
        table = {"frame": frame, "time_s": time_s}
        table["driven_rad"] = np.where(truth.driven.valid, truth.driven.steering_rad, np.nan)
        table |= {name: values[rows] for name, values in columns.items()}
        fault, lines = judge(agreement, truth.column, truth.ratio)
        if fault:
            doubts.append(fault)
        doubts += lines[1:]
        return cls(source.name, table, problems, truth, agreement, lines[:1], doubts)

    def columns(self) -> pd.DataFrame:
        """Return a row per frame: the recording, the columns, and those of a predicted path for
        each range.
        """
        names = [f"path_{near:g}_{far:g}m_1pm" for near, far in pairwise(self.ahead_m)]
        path = {} if self.path_1pm is None else dict(zip(names, self.path_1pm.T, strict=True))
        return pd.DataFrame({"drive": self.name, **self.table, **path})

    def write_csv(self, path: Path) -> None:
        """Write the :meth:`columns`; unknown values are empty."""
        table = self.columns()
        for name in table.columns[1:]:
            table[name] = table[name].map(
                f"{{:{FORMATS.get(name, '.6f')}}}".format, na_action="ignore"
            )
        table.to_csv(path, index=False)

    def lines(self, comparison: Mapping[str, Any] | None) -> Iterator[str]:
        """Yield text for the user: why motion could not be measured, and the result of
        :meth:`compare`.
        """
        counts = Counter(problem for problem in self.problems if problem).most_common()
        reasons = ", ".join(f"{problem} ({count})" for problem, count in counts)
        measured = (
            f"motion measured in {int(self.table['valid'].sum())} of {len(self.problems)} frames"
        )
        yield f"{measured}; not measured: {reasons}" if reasons else measured
        yield from self.agreement_lines
        if comparison is None:
            return
        ahead = f", {comparison['horizon']} frames ahead" if comparison["horizon"] else ""
        yield f"truth from {comparison['truth']}, {comparison['frames']} frames{ahead}:"
        for name in ("predicted", "measured", "zero"):
            if row := comparison.get(name):
                nmse = (
                    "-"
                    if row["nmse"] is None
                    else f"{row['nmse']:.3f} ({statistics.interval_text(row['nmse_ci95'])})"
                )
                text = (
                    "" if row["correlation"] is None else f", correlation {row['correlation']:.3f}"
                )
                yield f"  {name}: nmse {nmse}, RMSE {row['rmse_deg']:.2f} deg{text}"

    def compare(self, column: str, horizon: int = 0) -> dict[str, Any] | None:
        """Return errors of angles against the driven ones `horizon` frames later; None without
        common frames.

        They are computed on the frames of `column`, predicted or measured. The measured angle
        repeats the last, or 0.
        """
        frame, time_s, measured_rad = (
            self.table[name] for name in ("frame", "time_s", "measured_rad")
        )
        target_rad = (
            pd.Series(self.table["driven_rad"], frame).reindex(frame + horizon).to_numpy(copy=True)
        )
        used = np.isfinite(target_rad) & np.isfinite(self.table[f"{column}_rad"])
        if not used.any():
            return None
        held_rad = pd.Series(measured_rad).ffill().fillna(0.0).to_numpy()
        angles = {
            column: self.table[f"{column}_rad"],
            "measured": held_rad,
            "zero": np.zeros(len(frame)),
        }
        block = max(1, round(BLOCK_S / float(np.median(np.diff(time_s))))) if len(time_s) > 1 else 1
        settings = Evaluate(bootstrap_samples=2000, bootstrap_block_frames=block, seed=0)
        target_rad[~used] = np.nan
        scores = {name: _errors(target_rad, angle, settings) for name, angle in angles.items()}
        return {"truth": self.truth.name, "frames": int(used.sum()), "horizon": horizon, **scores}


def _backwards(path: Path, speed_mps: np.ndarray, truth: Truth, least_mps: float) -> Iterator[str]:
    """Yield a doubt if most moving frames of [F] are measured backwards. Raises InputError if a log
    says otherwise.
    """
    moves = np.abs(speed_mps) >= least_mps  # false for NaN
    back = moves & (speed_mps < 0)
    if back.sum() <= BACKWARDS * moves.sum():
        return
    problem = f"{int(back.sum())} of {int(moves.sum())} moving frames are measured backwards"
    logged_mps = truth.driven.speed_mps[back]
    if np.mean(logged_mps >= least_mps) > BACKWARDS:
        fix = (
            "Pass the front camera's recording. Causes are also images in reverse order, or of "
            "two cameras in one"
        )
        raise InputError(f"{problem}, forward by {truth.name}: the camera looks back?", path, fix)
    yield f"{problem}: the camera looks back? Then the angle has the wrong sign"


def _errors(target_rad: np.ndarray, angle_rad: np.ndarray, settings: Evaluate) -> dict[str, Any]:
    """Return nmse, its 95 % interval, rmse_deg and correlation of angles [N]; None where not
    defined.

    Frames without a target do not count.
    """
    error, known, drive = (
        (angle_rad - target_rad)[None] ** 2,
        np.isfinite(target_rad),
        np.zeros(len(target_rad), int),
    )
    parts = np.unique(statistics.parts(drive, settings.bootstrap_block_frames)[known])
    bounds = (
        statistics.interval(error, target_rad, drive, settings)
        if len(parts) >= statistics.LEAST_DRIVES
        else None
    )
    target_rad, angle_rad = target_rad[known], angle_rad[known]
    scores = statistics.scores(target_rad, angle_rad)
    varies = np.ptp(target_rad) > 0 and np.ptp(angle_rad) > 0
    return {
        "nmse": scores["nmse"],
        "nmse_ci95": bounds,
        "rmse_deg": math.degrees(scores["rmse"]),
        "correlation": float(np.corrcoef(target_rad, angle_rad)[0, 1]) if varies else None,
    }
