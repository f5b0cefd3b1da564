"""Read the targets and the measured motion of a drive, and scale them to a larger world.

Letters: G frames of a graph file, W windows, R columns of the quantity that a network predicts.
"""

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from models.steering.core.motion import ANGLE, SPEED, VALID
from models.steering.core.options import NetworkOptions
from models.steering.core.recurrent import NOMINAL_STEP_S
from pipeline.base.errors import InputError, error_context
from pipeline.base.store import DriveReader
from pipeline.graphs.graph_file import Arrays, Contents, Graphs, open_graphs
from pipeline.labels import label
from pipeline.labels.label_file import Labels, open_labels, read_labels
from pipeline.motion.motion_file import open_motion, read_causal
from pipeline.train.entry import Entry
from pipeline.train.quantity import Quantity, load_quantity, scale_radius


@dataclass(frozen=True)
class Timeline:
    """Times and measured motion of a graph file's G frames, by row."""

    graphs: Path
    frame: np.ndarray  # int32 [G], KITTI frame numbers, ascending
    time_s: np.ndarray  # float64 [G]
    # float64 [G,R], measured values to which the network's outputs are added. They are 0 if the
    # model's entry has motion: none or base: none.
    base: np.ndarray
    motion: np.ndarray | None  # float32 [G,4], as in windows.py; None if not an input
    network: NetworkOptions  # options of the spatial network, which may prepare frames

    @classmethod
    def read(
        cls, graphs: Graphs, motion_file: DriveReader | None, quantity: Quantity, entry: Entry
    ) -> "Timeline":
        """Read the times of a graph file, and the measured motion if the model needs it.

        Both files are open. `quantity` is what the model predicts. Raises InputError if a column
        that the network reads is missing, or if the model needs motion and `motion_file` is None or
        of another drive.
        """
        for name in entry.network.reads_columns:
            if name not in graphs.signs:
                problem = f"has no column {name!r}, which spatial: {entry.spatial} reads"
                fix = f"Add it to columns of graphs.{entry.input}, and make them again: dvc repro"
                raise InputError(problem, graphs.path, fix)
        base = np.zeros((len(graphs.frame), len(quantity.columns)))
        motion = None
        if entry.motion != "none":
            if motion_file is None:
                fix = "Pass the drive's file of stage motion, too"
                raise InputError("the model needs measured motion", graphs.path, fix)
            measured = read_causal(motion_file, graphs.drive, graphs.frame)
            angle_rad = label.measured_angle(*measured, quantity.car)
            columns = [np.nan_to_num(angle_rad), *measured]
            motion = np.stack(columns, axis=1).astype(np.float32)
            if entry.base == "motion":
                base = np.nan_to_num(quantity.measured(angle_rad))
        return cls(graphs.path, graphs.frame, graphs.time_s, base, motion, entry.network)

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
    """A drive's frames with their targets, the values of a quantity `horizon` frames later."""

    name: str
    labels: Path
    motion_file: Path
    # Section → settings that made graphs, labels, and the motion if it is an input.
    settings: dict[str, Any]
    contents: Contents  # kind and sizes of the graphs
    counts: Arrays  # numbers of points and edges per frame
    quantity: Quantity
    target: np.ndarray  # float64 [G,R], NaN without a valid label
    present: np.ndarray  # float64 [G,R], true values of the frames themselves
    driven: Labels  # labels of the frames themselves
    are_measured: bool  # whether labels follow from measured motion

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
        fix = (
            "If stage clouds printed 0 points, too, raise clouds.max_depth_m. Otherwise, widen the "
            "variant's crop_m"
        )
        raise InputError(f"0 points in all frames of {names}", folder, fix)
    if not any(drive.has_window(window) for drive in drives):
        title = first.quantity.title_at(first.quantity.horizon)
        lengths = [stop - start for drive in drives for start, stop in drive.stretches]
        problem = f"no window of {window} consecutive frames ends at a known {title} in {names}"
        raise InputError(
            f"{problem} (longest: {max(lengths, default=0)})",
            folder,
            "Use a smaller window, other drives or another input",
        )
    if not any(np.nan_to_num(drive.target).any() for drive in drives):
        problem = f"every known {first.quantity.title} of {names} is 0"
        raise InputError(problem, first.labels.parent, "Add drives with bends")


def read_drive(graphs: Path, labels: Path, motion: Path, name: str, entry: Entry) -> LabelledDrive:
    """Read a drive for a model from the folders `graphs`, `labels` and `motion`.

    The graphs themselves stay on disk. Motion is read only if the model needs it. Raises
    InputError.
    """
    graphs = graphs / f"{name}.h5"
    labels = labels / f"{name}.h5"
    motion = motion / f"{name}.h5"
    with ExitStack() as files:
        file = files.enter_context(open_graphs(graphs))
        truth = files.enter_context(open_labels(labels))
        measured = None
        settings = file.params | truth.params
        if entry.motion != "none":
            measured = files.enter_context(open_motion(motion))
            settings = measured.params | settings

        # For each frame of the graphs, find the row of its label, and the row of the label
        # `horizon` frames later. The row is -1 if there is no such label.
        row_of = {number: row for row, number in enumerate(truth.frame.tolist())}
        rows = np.array([row_of.get(number, -1) for number in file.frame.tolist()], np.int64)
        target_rows = [row_of.get(number + entry.horizon, -1) for number in file.frame.tolist()]
        if (rows < 0).any():
            problem = f"no label for frame {file.frame[rows < 0][0]} of {graphs}"
            raise InputError(problem, labels, "Make both again: dvc repro")
        driven = read_labels(truth).select_rows(rows)
        # Row -1, which stands for a missing label, is an additional row of NaN.
        with error_context(labels):
            quantity = load_quantity(entry.predict)(truth.params["labels"], entry.horizon)
        values = np.pad(_read_values(truth, quantity), ((0, 1), (0, 0)), constant_values=np.nan)

        timeline = Timeline.read(file, measured, quantity, entry)
        is_measured = timeline.motion is None or bool(timeline.motion[:, VALID].any())
        # Valid labels show that the car moved, so its motion could have been measured.
        if not is_measured and driven.valid.any():
            fix = f"Remove {name} from ingest.drives, or set motion: none"
            raise InputError("motion is not measured in any frame (it needs images)", motion, fix)
        return LabelledDrive(
            **vars(timeline),
            name=name,
            labels=labels,
            motion_file=motion,
            settings=settings,
            contents=file.contents,
            counts=file.counts,
            quantity=quantity,
            target=values[target_rows],
            present=values[rows],
            driven=driven,
            are_measured=bool(truth.attrs.get("measured", 0)),
        )


def _read_values(labels: DriveReader, quantity: Quantity) -> np.ndarray:
    """Return the true values of a quantity for the F frames of labels, [F,R]; NaN if unknown."""
    values = np.asarray(quantity.read(labels), np.float64)
    shape = (len(labels.frame), len(quantity.columns))
    if values.shape != shape:
        problem = f"{quantity.title}: read returns an array {values.shape}, expected {shape}"
        raise InputError(f"{problem}, a row per frame and the columns {quantity.columns}")
    return values


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
            _rescale_world(values, factor, timeline.quantity)
    if hidden:
        for name in ("motion", "base"):
            values[name] = np.zeros_like(values[name])
    return values


def _rescale_world(values: Arrays, factor: float, quantity: Quantity) -> None:
    """Scale motion, base and target to a world that is `factor` times as large.

    The yaw rate does not change.
    """
    values["base"] = quantity.rescale_measured(values["base"], factor)
    values["target"] = quantity.rescale(values["target"], factor)
    if "motion" in values:
        motion = values["motion"]  # a copy of the drive's rows
        motion[:, ANGLE] = scale_radius(motion[:, ANGLE], factor)
        motion[:, SPEED] *= factor
