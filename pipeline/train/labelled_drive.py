"""A drive's frames by row: times, measured motion, and targets from its labels, matched by frame number.

A column is a quantity that a network predicts: the steering angle, or the mean curvature in one range of the path
ahead. Letters: G frames of a graph file, R columns.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from models.steering.core.recurrent import NOMINAL_STEP_S
from pipeline.base import store
from pipeline.base.errors import InputError
from pipeline.graphs import graph_file
from pipeline.labels import label
from pipeline.settings.models import Entry


@dataclass(frozen=True)
class Timeline:
    """Times and motion of a graph file's G frames, by row."""

    graphs: Path
    frame: np.ndarray  # int32 [G], KITTI frame numbers, ascending
    time_s: np.ndarray  # float64 [G]
    dt_s: np.ndarray  # float32 [G], time since the previous frame; nominal at the start of a stretch
    stretches: tuple[tuple[int, int], ...]  # [start, stop) rows without a missing frame
    base: np.ndarray  # float64 [G], measured value that the output is added to, see `base` of a model's entry
    motion: np.ndarray | None  # float32 [G,4], as in windows.py; None without motion
    scene: Path  # graph file whose frames a network sees: this one, or another drive's, see `scene` of a model's entry

    @classmethod
    def read(cls, graphs: graph_file.Graphs, car: label.Car, entry: Entry) -> "Timeline":
        """Read the times of an open graph file, and the measured motion of a `car`, for a model."""
        stretches = consecutive(graphs.frame)
        dt_s = np.diff(graphs.time_s, prepend=np.nan)
        dt_s[[start for start, _ in stretches]] = NOMINAL_STEP_S
        offset, columns = np.zeros(len(graphs.frame)), None
        if entry.motion != "none":
            if (measured := graphs.motion) is None:
                raise InputError("no measured motion", graphs.path, "Make it again: dvc repro graphs")
            columns = np.stack([label.measured_angle(*measured, car), *measured], axis=1).astype(np.float32)
            offset = _measured(measured, car, entry.predict) if entry.base == "motion" else offset
        times = graphs.time_s, dt_s.astype(np.float32)
        return cls(graphs.path, graphs.frame, *times, stretches, offset, columns, graphs.path)


@dataclass(frozen=True)
class LabelledDrive(Timeline):
    """A drive's frames with their targets, of the angle `horizon` frames after each; arrays [G,R] unless noted."""

    name: str
    empty: bool  # no frame has a point
    labels: Path
    horizon: int
    car: label.Car
    ahead_m: tuple[float, ...]  # R+1 edges of the ranges of the path ahead; none with predict: angle
    target: np.ndarray  # float64, NaN without a label
    valid: np.ndarray  # bool; False without a label
    speed_mps: np.ndarray  # float64 [G], at the frame itself
    persistence: np.ndarray | None  # last valid label before the target and not after the frame; None for a path
    # Measured value, which a later unmeasured frame repeats; NaN before the first. None without motion in the file,
    # and at horizon 0 if the labels are from the same measurement.
    odometry: np.ndarray | None
    settings: dict[str, Any]  # section → settings that made graphs and labels

    @property
    def columns(self) -> list[str]:
        """One for each range of a path, or that of the angle."""
        return [f"path_{near:g}-{far:g}m_1pm" for near, far in pairwise(self.ahead_m)] or ["steering_rad"]

    @property
    def truth(self) -> np.ndarray:
        """The targets, NaN where they are not valid."""
        return np.where(self.valid, self.target, np.nan)

    def has_window(self, window: int) -> bool:
        """Return whether a window of consecutive frames ends at a valid target: the drive can train and evaluate."""
        return any(self.valid[start + window - 1 : stop].any() for start, stop in self.stretches)


def check(drives: Sequence[LabelledDrive], window: int) -> None:
    """Raise InputError if drives can neither train nor evaluate: no point, no window with a target, all labels 0."""
    names, first = ", ".join(drive.name for drive in drives), drives[0]
    if all(drive.empty for drive in drives):
        problem, fix = f"no point in any frame of {names}", "Widen the variant's crop_m or add drives"
        raise InputError(problem, first.graphs.parent, fix)
    if not any(drive.has_window(window) for drive in drives):
        target = f"a valid label {first.horizon} frames after"
        if first.ahead_m:
            target = f"a driven path of {first.ahead_m[1]:g} m ahead of"
        longest = max((stop - start for drive in drives for start, stop in drive.stretches), default=0)
        problem = f"no window of {window} consecutive frames with {target} its end in {names} (longest: {longest})"
        raise InputError(problem, first.graphs.parent, "Use a smaller window, other drives or another input")
    if not any(drive.target[drive.valid].any() for drive in drives):
        raise InputError(f"every valid label of {names} is 0", first.labels.parent, "Add drives with bends")


def read_drive(graphs: Path, labels: Path, name: str, entry: Entry) -> LabelledDrive:
    """Read a drive's labels from a folder of graphs and one of labels, for a model; graphs stay on disk.

    Raises InputError if a label is missing, the file has no such motion, or the car drives and no frame is measured.
    """
    graphs, labels = graphs / f"{name}.h5", labels / f"{name}.h5"
    horizon, path = entry.horizon, entry.predict == "path"
    with graph_file.open_graphs(graphs) as file, store.DriveReader(labels, stage="labels") as truth:
        row_of = {number: row for row, number in enumerate(truth.frame.tolist())}
        rows = [[row_of.get(number + ahead, -1) for number in file.frame.tolist()] for ahead in (0, horizon)]
        here, then = np.array(rows, np.int64)
        if (here < 0).any():
            problem = f"no label for frame {file.frame[here < 0][0]} of {graphs}"
            raise InputError(problem, labels, "Make both again: dvc repro")
        section, measured = truth.params["labels"], file.motion
        car = label.Car(section["wheelbase_m"], section["min_speed_mps"])
        if entry.motion != "none" and measured and not measured.valid.any() and truth["valid"][here].any():
            fix = f"Remove {name} from ingest.drives, or set motion: none"
            raise InputError("motion is not measured in any frame (it needs images)", graphs, fix)
        targets = _path(truth, here) if path else _angle(truth, here, then, including=horizon > 0)
        odometry = None
        if measured and (horizon or path or section.get("source") != "visual"):
            usable = label.is_usable(measured.speed_mps, measured.valid, car.min_speed_mps)
            held = np.where(np.logical_or.accumulate(usable), _measured(measured, car, entry.predict), np.nan)
            odometry = np.repeat(held[:, None], targets["target"].shape[1], axis=1)
        return LabelledDrive(
            **vars(Timeline.read(file, car, entry)),
            name=name,
            empty=file.empty,
            labels=labels,
            horizon=horizon,
            car=car,
            **targets,
            speed_mps=truth["speed_mps"][here],
            odometry=odometry,
            settings=file.params | truth.params,
        )


def _measured(motion: graph_file.MeasuredMotion, car: label.Car, predict: str) -> np.ndarray:
    """Return the measured angle [G], or the curvature for a path."""
    angle_rad = label.measured_angle(*motion, car)
    return np.tan(angle_rad) / car.wheelbase_m if predict == "path" else angle_rad


def _path(labels: store.DriveReader, here: np.ndarray) -> dict[str, Any]:
    """Return the fields of a LabelledDrive with the path ahead of the rows `here` [G] of its labels."""
    if "ahead_1pm" not in labels:
        fix = "Set labels.ahead_m and make the labels again: dvc repro labels"
        raise InputError("no path ahead (ahead_1pm), which predict: path needs", labels.path, fix)
    path_1pm = np.where(labels["ahead_valid"].astype(bool), labels["ahead_1pm"], np.nan)[here]
    fields = {"target": path_1pm, "valid": np.isfinite(path_1pm), "persistence": None}
    return fields | {"ahead_m": tuple(labels.params["labels"]["ahead_m"])}


def _angle(labels: store.DriveReader, here: np.ndarray, then: np.ndarray, including: bool) -> dict[str, Any]:
    """Return the fields of a LabelledDrive with the angle in the rows `then` [G] of its labels, -1 without a row.

    Persistence is the last valid label before each row `here` [G], or up to it if `including`; 0 without one.
    """
    steering_rad, valid = labels["steering_rad"], labels["valid"].astype(bool)
    known, usable = then >= 0, valid[here]
    last = np.maximum.accumulate(np.where(usable, np.arange(len(here)), -1))
    last = last if including else np.concatenate([[-1], last])[: len(here)]
    columns = {
        "target": np.where(known, steering_rad[then], np.nan),
        "valid": known & valid[then],
        "persistence": np.where(last >= 0, steering_rad[here][last], 0.0),
    }
    return {name: values[:, None] for name, values in columns.items()} | {"ahead_m": ()}


def consecutive(frame: np.ndarray) -> tuple[tuple[int, int], ...]:
    """Return the stretches [start, stop) of rows with consecutive frame numbers [G]."""
    if not len(frame):
        return ()
    edges = [0, *(np.flatnonzero(np.diff(frame) != 1) + 1).tolist(), len(frame)]
    return tuple(pairwise(edges))
