"""From graph files and labels to batches: runs of consecutive frames whose windows share their frames.

A window is `window` consecutive frames and predicts the steering at its last one. A span is a run of consecutive
frames that is read and encoded once; all its windows are unfolded from the embeddings.
Frames are consecutive by KITTI frame number, never by position: a missing frame ends a run.
"""

from collections.abc import Generator, Mapping, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.base import store
from pipeline.base.errors import InputError
from pipeline.train import frames

Batch = dict[str, np.ndarray]
"""The input of a network, as arrays. B frames, W windows of T frames: the frames as in pipeline/train/frames.py;
windows int64 [W,T] (rows of the batch's frames), dt_s float32 [W,T] (time since the frame before).
With targets: steering_rad float32 [W] and valid bool [W] at each window's last frame."""


@dataclass(frozen=True)
class Timeline:
    """The frames of a graph file in time, by row. G frames."""

    graphs: Path
    frame: np.ndarray  # int32 [G], KITTI frame numbers, ascending
    time_s: np.ndarray  # float64 [G]
    dt_s: np.ndarray  # float32 [G], time since the frame before; nominal at the start of a run
    runs: tuple[tuple[int, int], ...]  # [start, stop) rows of consecutive frames

    @classmethod
    def of(cls, graphs: frames.Graphs) -> "Timeline":
        from models.steering.core.recurrent import NOMINAL_STEP_S

        runs = consecutive(graphs.frame)
        dt_s = np.diff(graphs.time_s, prepend=np.nan)
        dt_s[[start for start, _ in runs]] = NOMINAL_STEP_S
        return cls(graphs.path, graphs.frame, graphs.time_s, dt_s.astype(np.float32), runs)

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
    """A drive's frames with their labels, [G] each."""

    name: str
    labels: Path
    steering_rad: np.ndarray  # float64
    speed_mps: np.ndarray  # float64
    curvature_1pm: np.ndarray  # float64
    valid: np.ndarray  # bool


@dataclass(frozen=True)
class Span:
    """Rows [start, stop) of timeline number `drive`; its windows end at rows start+window-1 … stop-1."""

    drive: int
    start: int
    stop: int


def read_drives(graphs: Path, labels: Path, names: Sequence[str], window: int) -> list[Drive]:
    """Read the labels of drives `names` and match them with the graphs by frame number; graphs stay on disk.

    Raises InputError if a label is missing, or if no window of `window` frames ends at a valid label.
    """
    drives = [_read_drive(graphs / f"{name}.h5", labels / f"{name}.h5", name) for name in names]
    if names and not any(_has_target(drive, window) for drive in drives):
        runs = [stop - start for drive in drives for start, stop in drive.runs]
        raise InputError(
            f"{graphs}: no window of {window} consecutive frames with a valid label at its end in {', '.join(names)} "
            f"(longest run: {max(runs, default=0)} frames): use a smaller window, other drives or another input"
        )
    if names and not any(drive.steering_rad[drive.valid].any() for drive in drives):
        raise InputError(
            f"{labels}: every valid label of {', '.join(names)} is 0, nothing to learn or judge: add drives"
        )
    return drives


def _read_drive(graphs: Path, labels: Path, name: str) -> Drive:
    with frames.open_graphs(graphs) as file, store.DriveReader(labels, stage="labels") as truth:
        row_of = {int(number): row for row, number in enumerate(truth.frame)}
        missing = [int(number) for number in file.frame if int(number) not in row_of]
        if missing:
            raise InputError(f"{labels} has no label for frame {missing[0]} of {graphs}: rebuild both with dvc repro")
        rows = np.array([row_of[int(number)] for number in file.frame], np.int64)
        columns: dict[str, Any] = {key: truth[key][rows] for key in ("steering_rad", "speed_mps", "curvature_1pm")}
        columns["valid"] = truth["valid"][rows].astype(bool)
        return Drive(**vars(Timeline.of(file)), name=name, labels=labels, **columns)


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


def examples(drives: Sequence[Drive], groups: Sequence[Sequence[Span]], window: int) -> Generator[Batch]:
    """Read each group of spans as one batch with targets, as :func:`batches` does."""
    with closing(batches(drives, groups, window)) as read:
        for group, batch in zip(groups, read, strict=True):
            ends = [(drives[span.drive], slice(span.start + window - 1, span.stop)) for span in group]
            steering_rad = np.concatenate([drive.steering_rad[rows] for drive, rows in ends])
            valid = np.concatenate([drive.valid[rows] for drive, rows in ends])
            yield batch | {"steering_rad": steering_rad.astype(np.float32), "valid": valid}


def _windows(timelines: Sequence[Timeline], group: Sequence[Span], window: int) -> Batch:
    windows, dt_s, before = [], [], 0  # frames of the batch before the span
    for span in group:
        count = span.stop - span.start
        rows = np.arange(count - window + 1)[:, None] + np.arange(window)  # [W,T]
        windows.append(rows + before)
        dt_s.append(timelines[span.drive].dt_s[span.start : span.stop][rows])
        before += count
    return {"windows": np.concatenate(windows), "dt_s": np.concatenate(dt_s)}
