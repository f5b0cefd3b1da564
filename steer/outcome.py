"""Make the table of a measured drive, its errors against ground truth, and quality.json."""

import math
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from pipeline.jobs.revision import revision

from pipeline.base.checkout import ROOT
from pipeline.base.metrics import nmse, rmse
from pipeline.base.store import DriveReader
from pipeline.base.summary import Summary, split_doubts
from pipeline.ingest.ingest_file import open_ingest
from pipeline.labels.label import Car, steering_angle, steering_labels
from pipeline.labels.label_file import Labels
from pipeline.labels.source import rates_of_motion, recorded_angles, recorded_rates
from pipeline.motion.facts import facts_line
from pipeline.motion.motion_file import PROBLEMS, is_standing, open_motion, read_rates
from pipeline.scores.recorded import Recorded, compare_recorded
from steer.chain import INGEST, MOTION, Source

# Longest gap in seconds over which the track continues with the last measured motion.
BRIDGED_S = 1.0
# Formats of columns in a CSV file; other columns have ".6f".
FORMATS = {"frame": ".0f", "valid": ".0f", "driven_rad": ".9f"}


class Outcome(NamedTuple):
    """The results for a caller of :mod:`steer.api`."""

    # A row per frame, as in motion.csv or steering.csv; NaN where unknown.
    table: pd.DataFrame
    notes: list[str]
    doubts: list[str]
    files: list[Path]


@dataclass
class Results:
    """The results of F frames, and their ground truth."""

    # Column → [F], NaN where unknown; angles in rad, left positive.
    table: dict[str, np.ndarray]
    # Reason why the motion of each frame is not measured; empty where it is.
    problems: list[str]
    # Labels by the recorded motion or angle, and what recorded them: empty if nothing did.
    driven: Labels
    recorder: str
    # Labels by the measured motion, which later frames smooth.
    measured: Labels
    # Quantity → facts about the recorded values beside the measured ones.
    recorded: dict[str, dict[str, Any]]
    # Summary of the motion, of which the line of facts is made.
    facts: Summary
    # Lines for the user.
    notes: list[str]
    doubts: list[str]
    # Name of a path ahead, predicted or taken → its curvature [N,F] in N steps, for the video.
    paths: dict[str, np.ndarray] = field(default_factory=dict)

    @classmethod
    def read(
        cls, source: Source, work: Path, facts: Summary, car: Car, *, smooth: bool
    ) -> "Results":
        """Return the measured motion that :func:`steer.chain.run_chain` wrote to `work`.

        `facts` is what it returned. Columns are frame, time_s, driven_rad, valid, and those of
        :func:`read_course`.
        """
        recorder = "the log"
        if source.files.oxts and not source.files.find_logs():
            recorder = "oxts"
        with (
            open_motion(work / MOTION) as motion,
            open_ingest(work / INGEST) as raw,
        ):
            rows = np.searchsorted(raw.frame, motion.frame)
            driven = _read_driven(raw, car)
            measured = rates_of_motion(raw, work / MOTION)
            measured_labels = steering_labels(measured.yaw_rate_radps, measured.speed_mps, car)
            recorded = compare_recorded([Recorded.read(raw, motion, car)], recorder)

            labels = (driven or _unknown_labels(len(raw.frame))).select_rows(rows)
            table = {
                "frame": motion.frame,
                "time_s": motion.time_s,
                "driven_rad": np.where(labels.valid, labels.steering_rad, np.nan),
                "valid": motion["valid"],
                **read_course(motion, car, smooth=smooth),
            }
            problems = [PROBLEMS[code] for code in motion["problem"]]

        lines = [facts_line(source.name, [facts])]
        lines += [comparison["line"] for comparison in recorded.values()]
        notes, doubts = split_doubts([*source.drive.notes, *lines])
        counts = Counter(problem for problem in problems if problem).most_common()
        if counts:
            reasons = ", ".join(f"{problem} ({count})" for problem, count in counts)
            notes.append(f"frames without a measurement: {reasons}")
        return cls(
            table=table,
            problems=problems,
            driven=labels,
            recorder=recorder if driven else "",
            measured=measured_labels.select_rows(rows),
            recorded=recorded,
            facts=facts,
            notes=notes,
            doubts=doubts,
        )

    def angles_rad(self) -> dict[str, np.ndarray]:
        """Return the angles [F] in rad that are driven, measured and predicted."""
        names = ("driven", "measured", "predicted")
        return {name: self.table[f"{name}_rad"] for name in names if f"{name}_rad" in self.table}

    def write_csv(self, path: Path, name: str) -> None:
        """Write the table of the drive `name`. Cells of unknown values are empty."""
        table = pd.DataFrame({"drive": name, **self.table})
        for column in table.columns[1:]:
            to_text = f"{{:{FORMATS.get(column, '.6f')}}}".format
            table[column] = table[column].map(to_text, na_action="ignore")
        table.to_csv(path, index=False)

    def compare_angles(self, column: str, horizon: int = 0) -> dict[str, Any] | None:
        """Return errors of angles against the truth `horizon` frames later.

        `column` is predicted or measured. Errors are computed on the frames that have a truth and a
        value of `column`. Returns None if there are no such frames.
        """
        frame = self.table["frame"]
        driven_rad = pd.Series(self.table["driven_rad"], frame)
        target_rad = driven_rad.reindex(frame + horizon).to_numpy()
        used = np.isfinite(target_rad) & np.isfinite(self.table[f"{column}_rad"])
        if not used.any():
            return None

        # Measured angles are a baseline on all of these frames: where none is measured, the last
        # one is repeated. Before the first, the baseline is 0.
        held_rad = pd.Series(self.table["measured_rad"]).ffill().fillna(0.0).to_numpy()
        angles = {"measured": held_rad}
        if column == "predicted":
            angles = {column: self.table["predicted_rad"], **angles}

        errors = {}
        for name, angle_rad in angles.items():
            errors[name] = {
                "nmse": nmse(target_rad[used], angle_rad[used]),
                "rmse_deg": math.degrees(rmse(target_rad[used], angle_rad[used])),
            }
        return {"truth": self.recorder, "frames": int(used.sum()), "horizon": horizon, **errors}

    def describe_quality(self, source: Source, comparison: dict[str, Any] | None) -> dict[str, Any]:
        """Return the content of quality.json. Unknown values are None."""
        camera = source.camera
        speed_sigma = self.table["speed_sigma"][self.table["valid"] > 0]
        # Medians of nothing are 0, and a height that is not known is assumed.
        facts = dict(self.facts)
        for name in ("step_s", "step_m", "road_height_m", "scatter"):
            facts[name] = facts[name] or None
        if not facts["scaled"]:
            facts["camera_height_m"] = None
        return {
            "version": version("semantic-steering"),
            "revision": revision(ROOT) or None,
            "source": str(source.path),
            "K": camera.K.round(3).tolist(),
            "horizon": camera.horizon,
            **facts,
            "speed_sigma": float(np.median(speed_sigma)) if len(speed_sigma) else None,
            "recorded": self.recorded,
            "comparison": comparison,
            "doubts": self.doubts,
        }


def _read_driven(ingest: DriveReader, car: Car) -> Labels | None:
    """Return labels by recorded angles or else recorded motion; None if the file has neither."""
    recorded = recorded_rates(ingest)
    angles = recorded_angles(ingest, recorded, car)
    if angles:
        # The track follows from a recorded yaw rate, never from a recorded angle.
        unknown = np.full(len(ingest.frame), np.nan)
        return angles._replace(yaw_rate_radps=recorded.yaw_rate_radps if recorded else unknown)
    if recorded:
        return steering_labels(recorded.yaw_rate_radps, recorded.speed_mps, car)
    return None


def _unknown_labels(frames: int) -> Labels:
    """Return labels of which nothing is known."""
    unknown = np.full(frames, np.nan)
    return Labels(
        steering_rad=unknown,
        valid=np.zeros(frames, bool),
        speed_mps=unknown,
        yaw_rate_radps=unknown,
    )


def read_course(motion: DriveReader, car: Car, *, smooth: bool) -> dict[str, np.ndarray]:
    """Return the course of the car from a file of stage motion: column → [F], NaN if not measured.

    Left and forward are positive. x and y are the position ahead and to the left of the first
    frame. ``speed_sigma`` is the standard deviation of the speed, relative to the speed;
    ``measured_sigma_rad`` is that of the angle. Curvature and angle are also NaN below the minimum
    speed. If `smooth` is true, rates depend on later frames, too.
    """
    yaw_rate, speed_mps, yaw_sigma, speed_sigma = read_rates(motion, smooth=smooth)

    # Curvature and angle follow from the bicycle model, which needs a moving car.
    is_fast = np.abs(np.nan_to_num(speed_mps)) >= car.min_speed_mps
    fast_mps = np.where(is_fast, speed_mps, np.nan)
    curvature = yaw_rate / fast_mps
    angle = steering_angle(yaw_rate, fast_mps, car.wheelbase_m)
    curvature_sigma = np.hypot(yaw_sigma / fast_mps, curvature * speed_sigma)
    angle_sigma = curvature_sigma * car.wheelbase_m * np.cos(angle) ** 2

    # In a short gap, the car continues with the last measured motion, unless it has stood since.
    time_s = motion.time_s
    valid = motion["valid"].astype(bool)
    steps = pd.DataFrame({"time_s": time_s, "speed_mps": speed_mps, "yaw_rate_radps": yaw_rate})
    held = steps[valid].reindex(steps.index, method="ffill")
    standing = steps[is_standing(motion)].reindex(steps.index, method="ffill")
    is_recent = time_s - held["time_s"] <= BRIDGED_S
    moves = is_recent & ~(standing["time_s"] > held["time_s"])
    held = held.where(moves, 0.0)
    place_m, heading_rad = integrate_motion(
        time_s, held["speed_mps"].to_numpy(), held["yaw_rate_radps"].to_numpy()
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


def comparison_lines(comparison: Mapping[str, Any] | None) -> Iterator[str]:
    """Yield errors by :meth:`Results.compare_angles` as lines for the user."""
    if comparison is None:
        return
    line = f"truth from {comparison['truth']}, {comparison['frames']} frames"
    if comparison["horizon"]:
        line += f", {comparison['horizon']} frames ahead"
    yield f"{line}:"
    for name in ("predicted", "measured"):
        if name in comparison:
            errors = comparison[name]
            text = f"  {name}: RMSE {errors['rmse_deg']:.2f} deg"
            if errors["nmse"] is not None:
                text += f", nmse {errors['nmse']:.3f}"
            yield text
