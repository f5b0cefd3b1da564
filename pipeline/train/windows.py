"""From graph files and labels to batches: runs of consecutive frames whose windows share their frames.

A window is `window` consecutive frames. Its target is the steering `horizon` frames after its last one, by number: of
that frame the labels alone must say something. A span is a run of consecutive frames that is read and encoded once; all
its windows are unfolded from the embeddings.
Frames are consecutive by KITTI frame number, never by position: a missing frame ends a run.
"""

from collections.abc import Generator, Mapping, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from pipeline import label
from pipeline.base import store
from pipeline.base.errors import InputError
from pipeline.train import frames

Batch = dict[str, np.ndarray]
"""The input of a network, as arrays. B frames, W windows of T frames: the frames as in pipeline/train/frames.py;
windows int64 [W,T] (rows of the batch's frames), dt_s float32 [W,T] (time since the frame before), base_rad float32
[W] (the angle to which the network's answer is added, of the window's last frame).
With motion: motion float32 [B,4], columns MOTION.
With targets: steering_rad float32 [W] and valid bool [W], of the frame `horizon` after each window's last one."""
MOTION = ("measured_rad", "yaw_rate_radps", "speed_mps", "valid")
"""What a network with motion is told of a frame: the measured steering angle, which is `base_rad` as well; the motion
since the frame before; whether that is measured. The first two change sign in the mirror, the others do not."""


@dataclass(frozen=True)
class Car:
    """What makes a steering angle of a car's motion: of section labels, as the labels are made of it."""

    wheelbase_m: float
    min_speed_mps: float

    @classmethod
    def of(cls, labels: store.DriveReader) -> "Car":
        section = labels.params["labels"]
        return cls(section["wheelbase_m"], section["min_speed_mps"])

    def measured_angle(self, motion: frames.Motion) -> np.ndarray:
        """Return the steering angle of measured motion, float64 [G] in rad, held where nothing is measured."""
        return label.measured_angle(*motion, self.wheelbase_m, self.min_speed_mps)


@dataclass(frozen=True)
class Timeline:
    """The frames of a graph file in time, by row. G frames."""

    graphs: Path
    frame: np.ndarray  # int32 [G], KITTI frame numbers, ascending
    time_s: np.ndarray  # float64 [G]
    dt_s: np.ndarray  # float32 [G], time since the frame before; nominal at the start of a run
    runs: tuple[tuple[int, int], ...]  # [start, stop) rows of consecutive frames
    base_rad: np.ndarray  # float64 [G], the measured steering angle; 0 without motion
    motion: np.ndarray | None  # float32 [G,4], columns MOTION; None without

    @classmethod
    def of(cls, graphs: frames.Graphs, motion: str = "none", car: Car | None = None) -> "Timeline":
        """Read the times of an open graph file, and the motion that a model's line asks for, of this `car`.

        Raises InputError if the file does not carry it.
        """
        from models.steering.core.recurrent import NOMINAL_STEP_S

        runs = consecutive(graphs.frame)
        dt_s = np.diff(graphs.time_s, prepend=np.nan)
        dt_s[[start for start, _ in runs]] = NOMINAL_STEP_S
        base_rad, columns = np.zeros(len(graphs.frame)), None
        if motion != "none":
            assert car is not None, "an angle needs a wheelbase"
            measured = graphs.motion(motion)
            base_rad = car.measured_angle(measured)
            columns = np.stack([base_rad, *measured], axis=1).astype(np.float32)
        return cls(graphs.path, graphs.frame, graphs.time_s, dt_s.astype(np.float32), runs, base_rad, columns)

    def rows_of(self, numbers: Sequence[int] | np.ndarray) -> np.ndarray:
        """Return the rows of frame `numbers`. Raises InputError naming the first that the file does not hold."""
        numbers = np.asarray(numbers)
        unknown = numbers[~np.isin(numbers, self.frame)]
        if len(unknown):
            held = f"{len(self.frame)} frames, {self.frame[0]} to {self.frame[-1]}" if len(self.frame) else "none"
            raise InputError(f"{self.graphs} has no frame {unknown[0]}: it holds {held}")
        return np.searchsorted(self.frame, numbers)


@dataclass(frozen=True)
class Drive(Timeline):
    """A drive's frames with what is to be predicted there, of the frame `horizon` after each, [G] each."""

    name: str
    empty: bool  # no frame of it holds a point
    labels: Path
    horizon: int
    car: Car
    steering_rad: np.ndarray  # float64, NaN where that frame has no label
    curvature_1pm: np.ndarray  # float64, likewise
    valid: np.ndarray  # bool; False where that frame has no label
    speed_mps: np.ndarray  # float64, at the frame itself
    held_rad: np.ndarray  # float64, the last valid label, before the target frame, that the frame itself may know; or 0
    # Kind of motion that the file carries → float64, the measured angle; NaN if no frame is measured, as without scans.
    measured_rad: dict[str, np.ndarray]


@dataclass(frozen=True)
class Span:
    """Rows [start, stop) of timeline number `drive`; its windows end at rows start+window-1 … stop-1."""

    drive: int
    start: int
    stop: int


def read_drives(
    graphs: Path, labels: Path, names: Sequence[str], window: int, horizon: int = 0, motion: str = "none"
) -> list[Drive]:
    """Read the labels of drives `names` and match them with the graphs by frame number; graphs stay on disk.

    `window`, `horizon` and `motion` as in a model's line. Raises InputError as :func:`read_drive`, or if all together
    have a :func:`fault`.
    """
    drives = [read_drive(graphs, labels, name, horizon, motion) for name in names]
    if names and (what := fault(drives, window)):
        raise InputError(what)
    return drives


def fault(drives: Sequence[Drive], window: int) -> str | None:
    """Return why nothing can be learned of `drives`, or judged by them: no point, no window with a target, no bend."""
    names = ", ".join(drive.name for drive in drives)
    seen = [drive for drive in drives if not drive.empty]
    if not seen and any(len(drive.frame) for drive in drives):
        return f"{drives[0].graphs.parent}: no point in any frame of {names}: widen the variant's crop_m, or add drives"
    if not any(_has_target(drive, window) for drive in seen):
        runs = [stop - start for drive in drives for start, stop in drive.runs]
        where = f"{drives[0].horizon} frames after its end" if drives[0].horizon else "at its end"
        return (
            f"{drives[0].graphs.parent}: no window of {window} consecutive frames with a valid label {where} in "
            f"{names} (longest run: {max(runs, default=0)} frames): use a smaller window, other drives or another input"
        )
    if not any(drive.steering_rad[drive.valid].any() for drive in drives):
        return f"{drives[0].labels.parent}: every valid label of {names} is 0, nothing to learn or judge: add drives"
    return None


def read_drive(graphs: Path, labels: Path, name: str, horizon: int = 0, motion: str = "none") -> Drive:
    """Read one drive's labels; arguments as of :func:`read_drives`.

    Raises InputError if a label is missing, or if the motion is: the file does not carry it, or the drive moves and no
    frame of it is measured.
    """
    graphs, labels = graphs / f"{name}.h5", labels / f"{name}.h5"
    with frames.open_graphs(graphs) as file, store.DriveReader(labels, stage="labels") as truth:
        row_of = {int(number): row for row, number in enumerate(truth.frame)}
        missing = [int(number) for number in file.frame if int(number) not in row_of]
        if missing:
            raise InputError(f"{labels} has no label for frame {missing[0]} of {graphs}: rebuild both with dvc repro")
        here = np.array([row_of[int(number)] for number in file.frame], np.int64)
        ahead = np.array([row_of.get(int(number) + horizon, -1) for number in file.frame], np.int64)
        steering_rad, valid, car = truth["steering_rad"], truth["valid"].astype(bool), Car.of(truth)
        measured = {kind: file.motion(kind).valid.any() for kind in file.motions}
        if valid[here].any() and not measured.get(motion, True):
            raise InputError(
                f"{graphs}: motion: {motion} is measured in no frame (lidar takes scans, visual takes images): "
                f"leave {name} out of ingest.drives, or choose another motion"
            )
        return Drive(
            **vars(Timeline.of(file, motion, car)),
            name=name,
            empty=file.empty,
            labels=labels,
            horizon=horizon,
            car=car,
            steering_rad=np.where(ahead >= 0, steering_rad[ahead], np.nan),
            curvature_1pm=np.where(ahead >= 0, truth["curvature_1pm"][ahead], np.nan),
            valid=(ahead >= 0) & valid[ahead],
            speed_mps=truth["speed_mps"][here],
            held_rad=_held(steering_rad[here], valid[here], known=horizon > 0),
            measured_rad={
                kind: car.measured_angle(file.motion(kind)) if known else np.full(len(here), np.nan)
                for kind, known in measured.items()
            },
        )


def _held(steering_rad: np.ndarray, valid: np.ndarray, known: bool) -> np.ndarray:
    """Return for each frame [F] of a drive the last valid label before it, or its own if that is `known`; else 0."""
    last = np.maximum.accumulate(np.where(valid, np.arange(len(valid)), -1))
    last = last if known else np.concatenate([[-1], last])[: len(valid)]
    return np.where(last >= 0, steering_rad[last], 0.0)


def consecutive(frame: np.ndarray) -> tuple[tuple[int, int], ...]:
    """Return the runs [start, stop) of rows whose frame numbers [G] follow each other without a gap."""
    if not len(frame):
        return ()
    edges = [0, *(np.flatnonzero(np.diff(frame) != 1) + 1).tolist(), len(frame)]
    return tuple(pairwise(edges))


def _has_target(drive: Drive, window: int) -> bool:
    return any(drive.valid[start + window - 1 : stop].any() for start, stop in drive.runs)


def random_spans(drives: Sequence[Drive], window: int, windows: int, rng: np.random.Generator) -> list[Span]:
    """Cut all runs into spans of at most `windows` windows of `window` frames; each window is in one span.

    Spans start at a random phase and come in random order, so that no two epochs batch alike. Spans without a valid
    target are left out.
    """
    spans = []
    for number, drive in enumerate(drives):
        for start, stop in drive.runs:
            last = start + window - 1  # row of the first window's last frame
            phase = int(rng.integers(windows))
            edges = [last, *range(last + phase, stop, windows), stop] if phase else [*range(last, stop, windows), stop]
            spans += [Span(number, a - window + 1, b) for a, b in pairwise(edges) if a < b and drive.valid[a:b].any()]
    rng.shuffle(spans)
    return spans


def spans(
    timelines: Sequence[Timeline], window: int, windows: int, rows: Sequence[np.ndarray] | None = None
) -> list[Span]:
    """Return, in order, the spans of at most `windows` windows that hold each whole window once.

    With `rows`, int [..] of each timeline, only what windows need that end there: windows that share or adjoin frames
    share a span, and frames that no window needs are in none.
    """
    cut: list[Span] = []
    for number, timeline in enumerate(timelines):
        wanted = np.ones(len(timeline.frame), bool) if rows is None else np.zeros(len(timeline.frame), bool)
        if rows is not None:
            wanted[rows[number]] = True
        for start, stop in timeline.runs:
            ends = range(start + window - 1, stop)  # rows of the windows' last frames
            span: Span | None = None
            for end in (row for row in ends if wanted[row]):
                if span and end - window + 1 <= span.stop and end - (span.start + window - 1) < windows:
                    span = cut[-1] = Span(number, span.start, end + 1)
                else:
                    span = Span(number, end - window + 1, end + 1)
                    cut.append(span)
    return cut


def batches(
    timelines: Sequence[Timeline],
    groups: Sequence[Sequence[Span]],
    window: int,
    opened: Mapping[int, frames.Graphs] | None = None,
) -> Generator[Batch]:
    """Read each group of spans as one batch without targets.

    Files stay open while the iterator lives; those of the timelines whose numbers are in `opened` are open already.
    """
    files = dict(opened or {})
    with ExitStack() as opening:
        for group in groups:
            for number in {span.drive for span in group} - files.keys():
                files[number] = opening.enter_context(frames.open_graphs(timelines[number].graphs))
            read = frames.concatenate([files[span.drive].read(span.start, span.stop) for span in group])
            yield read | _windows(timelines, group, window)


def examples(
    drives: Sequence[Drive],
    groups: Sequence[Sequence[Span]],
    window: int,
    opened: Mapping[int, frames.Graphs] | None = None,
) -> Generator[Batch]:
    """Read each group of spans as one batch with targets, as :func:`batches` does."""
    with closing(batches(drives, groups, window, opened)) as read:
        for group, batch in zip(groups, read, strict=True):
            ends = [(drives[span.drive], slice(span.start + window - 1, span.stop)) for span in group]
            steering_rad = np.concatenate([drive.steering_rad[rows] for drive, rows in ends])
            valid = np.concatenate([drive.valid[rows] for drive, rows in ends])
            # What has no label weighs nothing, but nothing times NaN is NaN.
            yield batch | {"steering_rad": np.nan_to_num(steering_rad).astype(np.float32), "valid": valid}


def _windows(timelines: Sequence[Timeline], group: Sequence[Span], window: int) -> Batch:
    windows, dt_s, base_rad, motion, before = [], [], [], [], 0  # frames of the batch before the span
    for span in group:
        timeline, rows = timelines[span.drive], slice(span.start, span.stop)
        of_windows = np.arange(span.stop - span.start - window + 1)[:, None] + np.arange(window)  # [W,T]
        windows.append(of_windows + before)
        dt_s.append(timeline.dt_s[rows][of_windows])
        base_rad.append(timeline.base_rad[rows][window - 1 :])
        if timeline.motion is not None:
            motion.append(timeline.motion[rows])
        before += span.stop - span.start
    batch = {
        "windows": np.concatenate(windows),
        "dt_s": np.concatenate(dt_s),
        "base_rad": np.concatenate(base_rad).astype(np.float32),
    }
    return batch | ({"motion": np.concatenate(motion)} if motion else {})
