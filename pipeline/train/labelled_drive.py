"""A drive's frames by row: times, measured motion, and targets from its labels.

Graph files and labels are matched by frame number.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.base import store
from pipeline.base.errors import InputError
from pipeline.graphs import graph_file
from pipeline.graphs.graph_file import MeasuredMotion
from pipeline.labels import label


@dataclass(frozen=True)
class Timeline:
    """Times and motion of a graph file's G frames, by row."""

    graphs: Path
    frame: np.ndarray  # int32 [G], KITTI frame numbers, ascending
    time_s: np.ndarray  # float64 [G]
    dt_s: np.ndarray  # float32 [G], time since the previous frame; nominal at the start of a run
    runs: tuple[tuple[int, int], ...]  # [start, stop) rows of consecutive frames
    base_rad: np.ndarray  # float64 [G], angle to which the output is added, see `base` of a model's entry
    motion: np.ndarray | None  # float32 [G,4], as in windows.py; None without motion
    scene: str  # same | another, see `scene` of a model's entry

    @classmethod
    def read(
        cls,
        graphs: graph_file.Graphs,
        motion: str = "none",
        car: label.Car | None = None,
        base: str = "motion",
        scene: str = "same",
    ) -> "Timeline":
        """Read the times of an open graph file, and the measured motion of a `car`.

        `motion`, `base` and `scene` as in a model's entry. Raises InputError if the file has no motion.
        """
        measured = None if motion == "none" else graphs.motion
        if motion != "none" and measured is None:
            raise InputError("no measured motion", graphs.path, "Make it again: dvc repro graphs")
        return cls.of(graphs.path, graphs.frame, graphs.time_s, measured, car, base, scene)

    @classmethod
    def of(
        cls,
        graphs: Path,
        frame: np.ndarray,
        time_s: np.ndarray,
        motion: MeasuredMotion | None,
        car: label.Car | None,
        base: str = "motion",
        scene: str = "same",
    ) -> "Timeline":
        """Return the timeline of frames with these numbers, times, and measured motion of a `car`."""
        from models.steering.core.recurrent import NOMINAL_STEP_S

        runs = consecutive(frame)
        dt_s = np.diff(time_s, prepend=np.nan)
        dt_s[[start for start, _ in runs]] = NOMINAL_STEP_S
        base_rad, columns = np.zeros(len(frame)), None
        if motion is not None:
            assert car is not None, "the steering angle needs a wheelbase"
            measured_rad = label.measured_angle(*motion, **vars(car))
            columns = np.stack([measured_rad, *motion], axis=1).astype(np.float32)
            base_rad = measured_rad if base == "motion" else base_rad
        return cls(graphs, frame, time_s, dt_s.astype(np.float32), runs, base_rad, columns, scene)

    def scene_shift(self, rng: np.random.Generator | None = None) -> int:
        """Return the number of rows from the frames of a span to the frames whose scenes it gets, 0 with scene: same.

        With scene: another, half of the drive, or with `rng` a random quarter to three quarters of it.
        """
        frames = len(self.frame)
        if self.scene == "same":
            return 0
        return frames // 2 if rng is None else int(rng.integers(frames // 4, frames - frames // 4 + 1))

    def rows(self, numbers: Sequence[int] | np.ndarray) -> np.ndarray:
        """Return the rows of frame `numbers`. Raises InputError for the first number that is not in the file."""
        numbers = np.asarray(numbers)
        unknown = numbers[~np.isin(numbers, self.frame)]
        if len(unknown):
            stored = f"{len(self.frame)} frames, {self.frame[0]} to {self.frame[-1]}" if len(self.frame) else "none"
            raise InputError(f"no frame {unknown[0]} (found: {stored})", self.graphs)
        return np.searchsorted(self.frame, numbers)


@dataclass(frozen=True)
class LabelledDrive(Timeline):
    """A drive's frames with their targets, `horizon` frames after each; arrays [G]."""

    name: str
    empty: bool  # no frame has a point
    labels: Path
    horizon: int
    car: label.Car
    steering_rad: np.ndarray  # float64, NaN without a label
    curvature_1pm: np.ndarray  # float64, NaN without a label
    valid: np.ndarray  # bool; False without a label. With predict: path, whether the path is known in any range
    speed_mps: np.ndarray  # float64, at the frame itself
    persistence_rad: np.ndarray  # float64, last valid label before the target and not after the frame itself; or 0
    label_source: str  # labels.source: oxts | visual | wheel
    # Kind of motion in the file → float64, the measured angle; NaN if no frame is measured, as without scans. At
    # horizon 0 without the kind that the labels are from, since it is the same measurement.
    measured_rad: dict[str, np.ndarray]
    ahead_m: tuple[float, ...]  # R+1 edges of the ranges of the path ahead; none with predict: angle
    path_1pm: np.ndarray  # float64 [G,R], NaN without a label

    @property
    def targets(self) -> np.ndarray:
        """The angle [G] or the path [G,R]."""
        return self.path_1pm if self.ahead_m else self.steering_rad

    def measured_1pm(self, kind: str) -> np.ndarray:
        """Return the measured curvature [G], left positive."""
        return np.tan(self.measured_rad[kind]) / self.car.wheelbase_m


def read_drives(
    graphs: Path,
    labels: Path,
    names: Sequence[str],
    window: int,
    **reading: Any,
) -> list[LabelledDrive]:
    """Read the labels of drives `names` and match them with the graphs by frame number; graphs stay on disk.

    `reading` are keyword arguments of :func:`read_drive`. Raises InputError as that, or a :func:`target_fault`.
    """
    drives = [read_drive(graphs, labels, name, **reading) for name in names]
    if names and (fault := target_fault(drives, window)):
        raise fault
    return drives


def target_fault(drives: Sequence[LabelledDrive], window: int) -> InputError | None:
    """Return why drives can neither train nor evaluate a network: no point, no window with a target, all labels 0."""
    names = ", ".join(drive.name for drive in drives)
    filled = [drive for drive in drives if not drive.empty]
    graphs, labels, horizon = drives[0].graphs.parent, drives[0].labels.parent, drives[0].horizon
    if not filled and any(len(drive.frame) for drive in drives):
        return InputError(f"no point in any frame of {names}", graphs, "Widen the variant's crop_m or add drives")
    if not any(drive.valid[start + window - 1 : stop].any() for drive in filled for start, stop in drive.runs):
        longest = max((stop - start for drive in drives for start, stop in drive.runs), default=0)
        target = f"a valid label {horizon} frames after its end" if horizon else "a valid label at its end"
        if drives[0].ahead_m:
            target = f"a driven path of {drives[0].ahead_m[1]:g} m ahead of its end"
        return InputError(
            f"no window of {window} consecutive frames with {target} in {names} (longest run: {longest} frames)",
            graphs,
            "Use a smaller window, other drives or another input",
        )
    if not any(np.nan_to_num(drive.targets[drive.valid]).any() for drive in drives):
        return InputError(f"every valid label of {names} is 0", labels, "Add drives with bends")
    return None


def read_drive(
    graphs: Path,
    labels: Path,
    name: str,
    horizon: int = 0,
    motion: str = "none",
    base: str = "motion",
    predict: str = "angle",
    scene: str = "same",
) -> LabelledDrive:
    """Read one drive's labels.

    Args:
        graphs, labels: folders of the graph variant and of the labels.
        horizon, motion, base, predict, scene: as in a model's entry.
    Raises:
        InputError: a label is missing, the file has no such motion, or the car drives and no frame is measured.
    """
    graphs, labels = graphs / f"{name}.h5", labels / f"{name}.h5"
    with graph_file.open_graphs(graphs) as file, store.DriveReader(labels, stage="labels") as truth:
        row_of = {int(number): row for row, number in enumerate(truth.frame)}
        missing = [int(number) for number in file.frame if int(number) not in row_of]
        if missing:
            raise InputError(f"no label for frame {missing[0]} of {graphs}", labels, "Make both again: dvc repro")
        here = np.array([row_of[int(number)] for number in file.frame], np.int64)
        ahead = np.array([row_of.get(int(number) + horizon, -1) for number in file.frame], np.int64)
        steering_rad, valid, section = truth["steering_rad"], truth["valid"].astype(bool), truth.params["labels"]
        car, source = label.Car(section["wheelbase_m"], section["min_speed_mps"]), section.get("source", "oxts")
        moved = {} if file.motion is None else {"visual": file.motion}
        if valid[here].any() and motion in moved and not moved[motion].valid.any():
            raise InputError(
                "motion is not measured in any frame (it needs images)",
                graphs,
                f"Remove {name} from ingest.drives, or set motion: none",
            )
        edges_m, path_1pm = _read_path(truth) if predict == "path" else ((), np.empty((len(valid), 0)))
        target_valid = np.isfinite(path_1pm[here]).any(axis=1) if edges_m else (ahead >= 0) & valid[ahead]
        return LabelledDrive(
            **vars(Timeline.read(file, motion, car, base, scene)),
            name=name,
            empty=file.empty,
            labels=labels,
            horizon=horizon,
            car=car,
            steering_rad=np.where(ahead >= 0, steering_rad[ahead], np.nan),
            curvature_1pm=np.where(ahead >= 0, truth["curvature_1pm"][ahead], np.nan),
            valid=np.asarray(target_valid),
            ahead_m=edges_m,
            path_1pm=path_1pm[here],
            speed_mps=truth["speed_mps"][here],
            label_source=source,
            persistence_rad=_hold(steering_rad[here], valid[here], including=horizon > 0),
            measured_rad={
                kind: label.measured_angle(*rates, **vars(car)) if rates.valid.any() else np.full(len(here), np.nan)
                for kind, rates in moved.items()
                if horizon or edges_m or kind != source
            },
        )


def _read_path(labels: store.DriveReader) -> tuple[tuple[float, ...], np.ndarray]:
    """Return the edges of the ranges, and the path ahead of all frames [F,R], NaN where it is not valid."""
    if "ahead_1pm" not in labels:
        fix = "Set labels.ahead_m and make the labels again: dvc repro labels"
        raise InputError("no path ahead (ahead_1pm), which predict: path needs", labels.path, fix)
    path_1pm = np.where(labels["ahead_valid"].astype(bool), labels["ahead_1pm"], np.nan)
    return tuple(labels.params["labels"]["ahead_m"]), path_1pm


def _hold(steering_rad: np.ndarray, valid: np.ndarray, including: bool) -> np.ndarray:
    """Return the last valid label before each frame [F] of a drive, or up to it if `including`; 0 without one."""
    last = np.maximum.accumulate(np.where(valid, np.arange(len(valid)), -1))
    last = last if including else np.concatenate([[-1], last])[: len(valid)]
    return np.where(last >= 0, steering_rad[last], 0.0)


def consecutive(frame: np.ndarray) -> tuple[tuple[int, int], ...]:
    """Return the runs [start, stop) of rows with consecutive frame numbers [G]."""
    if not len(frame):
        return ()
    edges = [0, *(np.flatnonzero(np.diff(frame) != 1) + 1).tolist(), len(frame)]
    return tuple(pairwise(edges))
