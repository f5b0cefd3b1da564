"""Results of a run, frame by frame: a CSV file, and errors of angles where the driven ones are known."""

import csv
import math
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.base.errors import InputError
from pipeline.base.store import DriveReader
from pipeline.evaluate import errors
from pipeline.labels.label import Car
from pipeline.motion.step import PROBLEMS
from pipeline.settings.evaluate import Evaluate
from pipeline.video.chain import INGEST, MOTION
from pipeline.video.course import read_course
from pipeline.video.source import Source
from pipeline.video.truth import Logs, Truth, read_truth

BLOCK_S = 5.0  # errors of nearer frames are correlated
INVERTED = -0.5  # largest correlation with the driven angle that means an inverted sign
BOOTSTRAP = Evaluate(
    bootstrap_samples=2000, bootstrap_block_frames=1, curvature_bins_1pm=[1.0], path="bicycle", seed=0
)  # for the interval of nmse
DIGITS = {"driven_rad": 9, "residual": 3}  # others: 6


@dataclass
class Results:
    """Columns of F frames, NaN where unknown, and what was driven."""

    name: str  # of the recording
    table: dict[str, np.ndarray]  # column → [F]; angles in rad, left positive
    problems: list[str]  # why the motion of each frame is not measured; empty where it is
    truth: Truth
    ahead_m: tuple[float, ...] = ()  # edges of the ranges of the predicted path, of models of the path
    path_1pm: np.ndarray | None = None  # [F,R] predicted mean curvature in each range
    path_sigma_1pm: np.ndarray | None = None  # [F,R] its standard deviation, of models with uncertainty

    @classmethod
    def read(
        cls, source: Source, work: Path, car: Car, logs: Logs, *, look_ahead: bool, frame: np.ndarray | None = None
    ) -> "Results":
        """Return the measured motion of the files that :func:`pipeline.video.chain.run_chain` wrote to `work`.

        Columns: frame, time_s, driven_rad, valid, those of :class:`pipeline.video.course.Course`, and the points that
        agree with the motion, with their median error `residual` in px. Arguments as of :func:`read_course`; `frame`:
        numbers of the frames in the results, if their motion is in the files; None: all.

        Raises InputError if there is no frame, or a log has angles of frames that the recording lacks.
        """
        with DriveReader(work / MOTION, stage="motion") as motion, DriveReader(work / INGEST, stage="ingest") as raw:
            rows = np.flatnonzero(np.isin(motion.frame, motion.frame if frame is None else frame))
            if not len(rows):
                raise InputError("no frame could be read", source.path, "; ".join(source.notes[:1]))
            if logs.wheel and source.complete:
                logs.wheel.check_frames(int(raw.frame[-1]))
            course = read_course(motion, car, look_ahead=look_ahead, height_known=source.height_known)
            truth = read_truth(raw, motion.frame[rows], logs, car)
            valid, codes = motion["valid"], motion["problem"][rows]
            points, residual = (np.where(valid, motion[name], np.nan) for name in ("inliers", "residual"))
            measured = {"valid": valid, **course._asdict(), "points": points, "residual": residual}
            table = {"frame": motion.frame[rows], "time_s": motion.time_s[rows], "driven_rad": truth.driven_rad}
        table |= {name: values[rows] for name, values in measured.items()}
        return cls(source.name, table, [PROBLEMS[code] for code in codes], truth)

    def write_csv(self, path: Path) -> None:
        """Write the columns, and those of a predicted path for each range."""
        table, names = dict(self.table), [f"path_{near:g}_{far:g}m" for near, far in pairwise(self.ahead_m)]
        for suffix, values in (("1pm", self.path_1pm), ("sigma_1pm", self.path_sigma_1pm)):
            if values is not None:
                table |= {f"{name}_{suffix}": column for name, column in zip(names, values.T, strict=True)}
        texts = [[_format(name, value) for value in values.tolist()] for name, values in table.items()]
        with path.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(["drive", *table])
            writer.writerows([self.name, *row] for row in zip(*texts, strict=True))

    def summary(self) -> dict[str, int]:
        """Return the numbers of frames, of those with measured motion, and of predictions."""
        predicted = (
            self.table.get("predicted_rad", np.full(1, np.nan)) if self.path_1pm is None else self.path_1pm[:, 0]
        )
        valid = int(self.table["valid"].sum())
        return {"frames": len(self.problems), "valid": valid, "predicted": int(np.isfinite(predicted).sum())}

    def lines(self, comparison: Mapping[str, Any] | None) -> Iterator[str]:
        """Yield text for the user: gaps, why motion could not be measured, and the result of :meth:`compare`."""
        frame = self.table["frame"].tolist()
        yield from (
            f"no frames between {before} and {after}" for before, after in pairwise(frame) if after > before + 1
        )
        counts = Counter(problem for problem in self.problems if problem).most_common()
        reasons = ", ".join(f"{problem} ({count})" for problem, count in counts)
        measured = f"motion measured in {int(self.table['valid'].sum())} of {len(frame)} frames"
        yield f"{measured}; not measured: {reasons}" if reasons else measured
        if comparison:
            yield from _comparison_lines(comparison, self.truth)

    def compare(self, column: str, horizon: int = 0) -> dict[str, Any] | None:
        """Return errors of angles against the driven ones `horizon` frames later; None without common frames.

        Args:
            column: predicted or measured; errors are computed on its frames. Elsewhere the measured angle repeats the
                last one, or 0.
        """
        table = self.table
        driven = dict(zip(table["frame"].tolist(), table["driven_rad"].tolist(), strict=True))
        target_rad = np.array([driven.get(frame + horizon, math.nan) for frame in table["frame"].tolist()])
        angle_rad, measured_rad, time_s = table[f"{column}_rad"], table["measured_rad"], table["time_s"]
        used = np.isfinite(target_rad) & np.isfinite(angle_rad)
        if not used.any():
            return None
        rows = {column: angle_rad}
        if np.isfinite(measured_rad).any():
            last = np.maximum.accumulate(np.where(np.isfinite(measured_rad), np.arange(len(time_s)), -1))
            rows["measured"] = np.where(last >= 0, measured_rad[last], 0.0)
        rows["zero"] = np.zeros(len(time_s))
        block = max(1, round(BLOCK_S / float(np.median(np.diff(time_s))))) if len(time_s) > 1 else 1
        settings = BOOTSTRAP.model_copy(update={"bootstrap_block_frames": block})
        scores = {name: _errors(target_rad[used], angle[used], settings) for name, angle in rows.items()}
        return {"truth": self.truth.name, "frames": int(used.sum()), "horizon": horizon, **scores}


def _format(name: str, value: float) -> str:
    if math.isnan(value):
        return ""
    return str(int(value)) if name in ("frame", "valid", "points") else f"{value:.{DIGITS.get(name, 6)}f}"


def _errors(target_rad: np.ndarray, angle_rad: np.ndarray, settings: Evaluate) -> dict[str, Any]:
    """Return nmse, its 95 % interval, rmse_deg and correlation of angles [N]; None where not defined."""
    error, zero, drive = (angle_rad - target_rad) ** 2, float((target_rad**2).mean()), np.zeros(len(target_rad), int)
    varies = np.ptp(target_rad) > 0 and np.ptp(angle_rad) > 0
    return {
        "nmse": float(error.mean()) / zero if zero else None,
        "nmse_ci95": errors.interval(error, target_rad, drive, settings) if zero else None,
        "rmse_deg": math.degrees(math.sqrt(error.mean())),
        "correlation": float(np.corrcoef(target_rad, angle_rad)[0, 1]) if varies else None,
    }


def _comparison_lines(comparison: Mapping[str, Any], truth: Truth) -> Iterator[str]:
    """Yield text for the user of :meth:`Results.compare`."""
    ahead = f", {comparison['horizon']} frames ahead" if comparison["horizon"] else ""
    yield f"truth from {comparison['truth']}, {comparison['frames']} frames{ahead}:"
    for name in ("predicted", "measured", "zero"):
        if row := comparison.get(name):
            nmse = "-" if row["nmse"] is None else f"{row['nmse']:.3f} ({errors.interval_text(row['nmse_ci95'])})"
            correlation = "" if row["correlation"] is None else f", correlation {row['correlation']:.3f}"
            yield f"  {name}: nmse {nmse}, RMSE {row['rmse_deg']:.2f} deg{correlation}"
    measured = comparison.get("measured")
    if measured and measured["correlation"] is not None and measured["correlation"] < INVERTED:
        yield f"the sign of {truth.column} is inverted: left is positive"
