"""Read the targets and the measured motion of a drive, and scale them to a larger world.

A column is a quantity that a network predicts: the steering angle, or the mean curvature in one
range of the path ahead. Letters: G frames of a graph file, W windows, R columns.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from models.steering.core.motion import ANGLE, SPEED
from models.steering.core.recurrent import NOMINAL_STEP_S
from pipeline.base.errors import InputError
from pipeline.base.params import RATE_TOLERANCE
from pipeline.base.store import DriveReader
from pipeline.graphs.graph_file import Arrays, Contents, Graphs, MeasuredMotion, open_graphs
from pipeline.labels import label
from pipeline.train.entry import Entry


@dataclass(frozen=True)
class Timeline:
    """Times and measured motion of a graph file's G frames, by row."""

    graphs: Path
    # Graph file of the frames that a network sees: `graphs`, or the file of another drive if the
    # model's entry has scene: another.
    scene: Path
    frame: np.ndarray  # int32 [G], KITTI frame numbers, ascending
    time_s: np.ndarray  # float64 [G]
    # float64 [G], measured value to which the network's output is added. It is 0 if the model's
    # entry has motion: none or base: none.
    base: np.ndarray
    motion: np.ndarray | None  # float32 [G,4], as in windows.py; None if not an input

    @classmethod
    def read(cls, graphs: Graphs, car: label.Car, entry: Entry) -> "Timeline":
        """Read the times of an open graph file, and the measured motion if the model needs it.

        `car` converts yaw rate and speed to an angle. Raises InputError if motion is missing.
        """
        base = np.zeros(len(graphs.frame))
        motion = None
        if entry.motion != "none":
            measured = graphs.motion
            if measured is None:
                raise InputError(
                    "no measured motion", graphs.path, "Make it again: dvc repro graphs"
                )
            angle_rad = np.nan_to_num(label.measured_angle(*measured, car))
            motion = np.stack([angle_rad, *measured], axis=1).astype(np.float32)
            if entry.base == "motion":
                base = np.nan_to_num(_odometry(measured, car, entry))
        return cls(graphs.path, graphs.path, graphs.frame, graphs.time_s, base, motion)

    @cached_property
    def stretches(self) -> list[tuple[int, int]]:
        """The stretches [start, stop) of rows with consecutive frame numbers."""
        if not len(self.frame):
            return []
        gaps = np.flatnonzero(np.diff(self.frame) != 1) + 1
        return [*pairwise([0, *gaps.tolist(), len(self.frame)])]

    @cached_property
    def dt_s(self) -> np.ndarray:
        """Time since the previous frame, float32 [G]; nominal at the start of a stretch."""
        dt_s = np.diff(self.time_s, prepend=np.nan)
        dt_s[[start for start, _ in self.stretches]] = NOMINAL_STEP_S
        return dt_s.astype(np.float32)


@dataclass(frozen=True)
class LabelledDrive(Timeline):
    """A drive's frames with their targets.

    The target of a frame is the angle `horizon` frames later, or the path ahead of the frame.
    """

    name: str
    labels: Path
    settings: dict[str, Any]  # section → settings that made graphs and labels
    contents: Contents  # kind and sizes of the graphs
    counts: Arrays  # numbers of points and edges per frame
    horizon: int
    # Edges of the R ranges of the path ahead, R+1; none with predict: angle.
    ahead_m: tuple[float, ...]
    target: np.ndarray  # float64 [G,R], NaN without a valid label
    driven: label.Labels  # labels of the frames themselves
    # Measured angle or curvature [G,1]. A frame that was not measured has the value of the last
    # measured frame before it, or NaN if there is none. The field is None if the file has no
    # motion, or if the targets are of the same frames and from the same measurement.
    odometry: np.ndarray | None

    @property
    def columns(self) -> list[str]:
        """Names of the R columns."""
        if not self.ahead_m:
            return ["steering_rad"]
        return [f"path_{near:g}-{far:g}m_1pm" for near, far in pairwise(self.ahead_m)]

    def has_target(self, start: int, stop: int) -> bool:
        """Return whether a row of [start, stop) has a target."""
        return bool(np.isfinite(self.target[start:stop]).any())

    def has_window(self, window: int) -> bool:
        """Return whether a window of consecutive frames ends at a target.

        Only then can the drive train and evaluate.
        """
        return any(self.has_target(start + window - 1, stop) for start, stop in self.stretches)


# Name → drive.
Drives = Mapping[str, LabelledDrive]


def check_drives(drives: Sequence[LabelledDrive], window: int) -> None:
    """Raise InputError if drives can neither train nor evaluate.

    Together they need a point in some frame, a window with a target, and a label other than 0.
    """
    names = ", ".join(drive.name for drive in drives)
    first = drives[0]
    folder = first.graphs.parent
    # Images have no count of points, and pass this check.
    if not any(drive.counts.get("points", np.ones(len(drive.frame))).any() for drive in drives):
        raise InputError(
            f"no point in any frame of {names}", folder, "Widen the variant's crop_m or add drives"
        )
    if not any(drive.has_window(window) for drive in drives):
        target = f"a valid label {first.horizon} frames after"
        if first.ahead_m:
            target = f"a driven path of {first.ahead_m[1]:g} m ahead of"
        lengths = [stop - start for drive in drives for start, stop in drive.stretches]
        problem = f"no window of {window} consecutive frames with {target} its end in {names}"
        raise InputError(
            f"{problem} (longest: {max(lengths, default=0)})",
            folder,
            "Use a smaller window, other drives or another input",
        )
    if not any(np.nan_to_num(drive.target).any() for drive in drives):
        raise InputError(
            f"every valid label of {names} is 0", first.labels.parent, "Add drives with bends"
        )


def rate_doubt(drives: Drives, train: Sequence[str]) -> str | None:
    """Return a doubt if `drives` have other frame rates than the drives `train`, or None."""
    hz = {}
    for name, drive in drives.items():
        if len(drive.time_s) > 1:
            hz[name] = 1 / np.median(np.diff(drive.time_s))
    usual_hz = np.median([hz[name] for name in train if name in hz])
    unusual = [name for name in hz if abs(hz[name] / usual_hz - 1) > RATE_TOLERANCE]
    if not unusual:
        return None
    rates = ", ".join(f"{name} {hz[name]:.1f}" for name in unusual)
    return f"training drives have {usual_hz:.1f} frames/s, but {rates}"


def read_drive(graphs: Path, labels: Path, name: str, entry: Entry) -> LabelledDrive:
    """Read a drive for a model from the folders `graphs` and `labels`. Raises InputError.

    The graphs themselves stay on disk.
    """
    graphs = graphs / f"{name}.h5"
    labels = labels / f"{name}.h5"
    with open_graphs(graphs) as file, DriveReader(labels, stage="labels") as truth:
        # For each frame of the graphs, find the row of its label, and the row of the label
        # `horizon` frames later. The row is -1 if there is no such label.
        row_of = {number: row for row, number in enumerate(truth.frame.tolist())}
        rows = np.array([row_of.get(number, -1) for number in file.frame.tolist()], np.int64)
        target_rows = [row_of.get(number + entry.horizon, -1) for number in file.frame.tolist()]
        if (rows < 0).any():
            problem = f"no label for frame {file.frame[rows < 0][0]} of {graphs}"
            raise InputError(problem, labels, "Make both again: dvc repro")
        driven = label.read_labels(truth).at(rows)
        measured = file.motion
        # Valid labels show that the car moved, so its motion could have been measured.
        if entry.motion != "none" and measured and not measured.valid.any() and driven.valid.any():
            fix = f"Remove {name} from ingest.drives, or set motion: none"
            raise InputError("motion is not measured in any frame (it needs images)", graphs, fix)

        # Row -1, which stands for a missing label, is an additional row of NaN.
        targets = np.pad(_targets(truth, entry), ((0, 1), (0, 0)), constant_values=np.nan)

        # Labels that are from the same measurement cannot judge it, unless they lie ahead of it.
        section = truth.params["labels"]
        car = label.Car(section["wheelbase_m"], section["min_speed_mps"])
        odometry = None
        if measured and (entry.predicts_ahead or not truth.attrs.get("measured", 0)):
            odometry = _odometry(measured, car, entry)[:, None]
        return LabelledDrive(
            **vars(Timeline.read(file, car, entry)),
            name=name,
            labels=labels,
            settings=file.params | truth.params,
            contents=file.contents,
            counts=file.counts,
            horizon=entry.horizon,
            ahead_m=tuple(section["ahead_m"]) if entry.predict == "path" else (),
            target=targets[target_rows],
            driven=driven,
            odometry=odometry,
        )


def _targets(labels: DriveReader, entry: Entry) -> np.ndarray:
    """Return the quantities that a model predicts, [F,R] for F frames of labels; NaN if unknown.

    Raises InputError if the model predicts the path ahead and the labels lack it.
    """
    if entry.predict == "angle":
        return np.where(labels["valid"], labels["steering_rad"], np.nan)[:, None]
    if "ahead_1pm" not in labels:
        fix = "Set labels.ahead_m and make the labels again: dvc repro labels"
        raise InputError("no path ahead (ahead_1pm), which predict: path needs", labels.path, fix)
    return np.where(labels["ahead_valid"], labels["ahead_1pm"], np.nan)


def _odometry(motion: MeasuredMotion, car: label.Car, entry: Entry) -> np.ndarray:
    """Return the measured angle [G], or for a path the curvature; NaN if not measured yet."""
    angle_rad = label.measured_angle(*motion, car)
    if entry.predict == "path":
        return np.tan(angle_rad) / car.wheelbase_m
    return angle_rad


def window_values(
    timeline: Timeline, rows: np.ndarray, ends: np.ndarray, factor: float, hidden: bool
) -> Arrays:
    """Return motion at `rows`, and base and target of the windows that end at the rows `ends`.

    The values hold in a world `factor` times as large. With `hidden`, motion and base are 0.
    """
    values: Arrays = {"base": timeline.base[ends].astype(np.float32)}
    if timeline.motion is not None:
        values["motion"] = timeline.motion[rows]
    if isinstance(timeline, LabelledDrive):
        values["target"] = timeline.target[ends].astype(np.float32)
        if factor != 1:
            _rescale(values, factor, timeline.ahead_m)
    if hidden:
        for name in ("motion", "base"):
            values[name] = np.zeros_like(values[name])
    return values


def _rescale(values: Arrays, factor: float, ahead_m: Sequence[float]) -> None:
    """Scale motion, base and target to a world that is `factor` times as large.

    The bicycle model's tan Θ is wheelbase × curvature, and curvature is 1 / length; the yaw rate
    does not change.
    """
    if ahead_m:
        values["base"] = values["base"] / factor
        values["target"] = scale_path(values["target"], ahead_m, factor)
    else:
        for name in ("base", "target"):
            values[name] = _scale_radius(values[name], factor)
    if "motion" in values:
        motion = values["motion"]  # a copy of the drive's rows
        motion[:, ANGLE] = _scale_radius(motion[:, ANGLE], factor)
        motion[:, SPEED] *= factor


def scale_path(path_1pm: np.ndarray, ahead_m: Sequence[float], factor: float) -> np.ndarray:
    """Return the path ahead [W,R] in a world `factor` times as large, NaN where it is unknown.

    A range of that world is 1 / factor as long in the world of the labels. So it overlaps several
    of their ranges, whose curvature counts as constant within each. It is unknown where one of
    these is unknown, or where the labels end.
    """
    edges_m = np.array(ahead_m, np.float32)
    near = edges_m[:-1]
    far = edges_m[1:]

    # Share of each range of the labels in each range of the larger world, [R,R].
    starts = np.maximum(near[:, None] / factor, near)
    ends = np.minimum(far[:, None] / factor, far)
    share = np.maximum(ends - starts, 0) * factor / (far - near)[:, None]

    # The shares of a range sum to 1, but for rounding, if all of it is known.
    is_known = (share * np.isfinite(path_1pm)[:, None]).sum(axis=2) > 1 - 1e-4
    scaled = (share * np.nan_to_num(path_1pm)[:, None]).sum(axis=2) / factor
    return np.where(is_known, scaled, np.nan).astype(path_1pm.dtype)


def _scale_radius(steering_rad: np.ndarray, factor: float) -> np.ndarray:
    """Return the steering angle in bends with `factor` times the radius."""
    return np.arctan(np.tan(steering_rad) / factor)
