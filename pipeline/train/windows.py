"""From graph files and labels to training batches: runs of consecutive frames whose windows share their frames.

A window is `length` consecutive frames and predicts the steering at its last one. A span is a run of consecutive
frames that is read and encoded once; all its windows are unfolded from the embeddings (DESIGN decision 12).
Frames are consecutive by KITTI frame number, never by position: a missing frame ends a run.
"""

from collections.abc import Generator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from pipeline.base import store
from pipeline.base.errors import InputError
from pipeline.train import frames

NOMINAL_DT_S = 0.1  # KITTI's synced stream: 10 Hz

Batch = dict[str, np.ndarray]
"""What a network eats, as arrays. B frames, W windows of T frames: the frames as in pipeline/train/frames.py;
windows int64 [W,T] (rows of the batch's frames), dt_s float32 [W,T] (time since the frame before),
steering_rad float32 [W] and valid bool [W] at each window's last frame."""


@dataclass(frozen=True)
class Drive:
    """A drive's frames that have both a graph and a label, by row of the graph file. G such frames."""

    name: str
    graphs: Path
    labels: Path
    frame: np.ndarray  # int32 [G]
    time_s: np.ndarray  # float64 [G]
    dt_s: np.ndarray  # float32 [G], time since the frame before; nominal at the start of a run
    steering_rad: np.ndarray  # float64 [G]
    speed_mps: np.ndarray  # float64 [G]
    curvature_1pm: np.ndarray  # float64 [G]
    valid: np.ndarray  # bool [G]
    runs: tuple[tuple[int, int], ...]  # [start, stop) rows of consecutive frames


@dataclass(frozen=True)
class Span:
    """Rows [start, stop) of drive number `drive`; its windows end at rows start+length-1 … stop-1."""

    drive: int
    start: int
    stop: int


def read_drives(graphs: Path, labels: Path, names: Sequence[str], length: int) -> list[Drive]:
    """Read the labels of drives `names` and match them with the graphs by frame number; graphs stay on disk.

    Raises InputError if a label is missing, or if no window of `length` frames ends at a valid label.
    """
    drives = [_read_drive(graphs / f"{name}.h5", labels / f"{name}.h5", name) for name in names]
    if names and not any(_has_target(drive, length) for drive in drives):
        runs = [stop - start for drive in drives for start, stop in drive.runs]
        raise InputError(
            f"{graphs}: no window of {length} consecutive frames with a valid label at its end in {', '.join(names)} "
            f"(longest run: {max(runs, default=0)} frames): use a smaller window, other drives or another input"
        )
    if names and not any(drive.steering_rad[drive.valid].any() for drive in drives):
        raise InputError(
            f"{labels}: every valid label of {', '.join(names)} is 0, nothing to learn or judge: add drives"
        )
    return drives


def _read_drive(graphs: Path, labels: Path, name: str) -> Drive:
    with store.DriveReader(graphs, stage="graphs") as file, store.DriveReader(labels, stage="labels") as truth:
        row_of = {int(number): row for row, number in enumerate(truth.frame)}
        missing = [int(number) for number in file.frame if int(number) not in row_of]
        if missing:
            raise InputError(f"{labels} has no label for frame {missing[0]} of {graphs}: make both again: dvc repro")
        rows = np.array([row_of[int(number)] for number in file.frame], np.int64)
        runs = consecutive(file.frame)
        dt_s = np.diff(file.time_s, prepend=np.nan)
        dt_s[[start for start, _ in runs]] = NOMINAL_DT_S
        return Drive(
            name=name,
            graphs=graphs,
            labels=labels,
            frame=file.frame,
            time_s=file.time_s,
            dt_s=dt_s.astype(np.float32),
            valid=truth["valid"][rows].astype(bool),
            runs=runs,
            **{key: truth[key][rows] for key in ("steering_rad", "speed_mps", "curvature_1pm")},
        )


def consecutive(frame: np.ndarray) -> tuple[tuple[int, int], ...]:
    """Return the runs [start, stop) of rows whose frame numbers [G] follow each other without a gap."""
    if not len(frame):
        return ()
    edges = [0, *(np.flatnonzero(np.diff(frame) != 1) + 1).tolist(), len(frame)]
    return tuple(pairwise(edges))


def _has_target(drive: Drive, length: int) -> bool:
    return any(drive.valid[start + length - 1 : stop].any() for start, stop in drive.runs)


def spans(drives: Sequence[Drive], length: int, windows: int, rng: np.random.Generator | None = None) -> list[Span]:
    """Cut all runs into spans of at most `windows` windows of `length` frames; each window is in one span.

    With `rng`, spans start at a random phase and come in random order, so that no two epochs batch alike. Spans
    without a valid target are left out then; without `rng` all are there, in order.
    """
    found = []
    for number, drive in enumerate(drives):
        for start, stop in drive.runs:
            last = start + length - 1  # row of the first window's last frame
            phase = int(rng.integers(windows)) if rng else 0
            edges = [last, *range(last + phase, stop, windows), stop] if phase else [*range(last, stop, windows), stop]
            for a, b in pairwise(edges):
                if a < b and (rng is None or drive.valid[a:b].any()):
                    found.append(Span(number, a - length + 1, b))
    if rng:
        rng.shuffle(found)
    return found


def batches(drives: Sequence[Drive], groups: Sequence[Sequence[Span]], length: int) -> Generator[Batch]:
    """Read each group of spans as one batch. Files stay open while the iterator lives."""
    files: dict[int, frames.Reader] = {}
    with ExitStack() as opened:
        for group in groups:
            for number in {span.drive for span in group} - files.keys():
                file = opened.enter_context(store.DriveReader(drives[number].graphs, stage="graphs"))
                files[number] = frames.Reader(file)
            read = frames.concatenate([files[span.drive].read(span.start, span.stop) for span in group])
            yield read | _windows(drives, group, length)


def _windows(drives: Sequence[Drive], group: Sequence[Span], length: int) -> Batch:
    parts, before = [], 0  # frames of the batch before the span
    for span in group:
        drive, rows = drives[span.drive], slice(span.start, span.stop)
        windows = np.arange(span.stop - span.start - length + 1)[:, None] + np.arange(length)  # [W,T]
        row = span.start + windows[:, -1]
        parts.append({
            "windows": windows + before,
            "dt_s": drive.dt_s[rows][windows],
            "steering_rad": drive.steering_rad[row].astype(np.float32),
            "valid": drive.valid[row],
        })  # fmt: skip
        before += span.stop - span.start
    return {key: np.concatenate([part[key] for part in parts]) for key in parts[0]}


def mirror(batch: Batch, chosen: np.ndarray) -> Batch:
    """Reflect the spans' windows and points, or images, left-right: x → −x, steering → −steering; every edge stays.

    `chosen` bool [B]: which of the batch's frames to reflect; all frames of a span together.
    """
    steering_rad = batch["steering_rad"].copy()
    steering_rad[chosen[batch["windows"][:, -1]]] *= -1
    if "image" in batch:  # KITTI's optical axis meets the image within 2 % of its middle
        image = batch["image"].copy()
        image[chosen] = image[chosen, :, ::-1]
        return batch | {"image": image, "steering_rad": steering_rad}
    xyz = batch["xyz"].copy()
    xyz[np.repeat(chosen, np.diff(batch["ptr"])), 0] *= -1
    return batch | {"xyz": xyz, "steering_rad": steering_rad}


def rescale(batch: Batch, factor: np.ndarray) -> Batch:
    """Make the world of each frame `factor` [B] times as large, and its bends as much wider; every edge stays.

    The bicycle model's tan Θ is wheelbase times curvature, and curvature is 1 / length. All frames of a span together.
    Images stay as they are, and so does their steering: a larger world gives the same image.
    """
    if "image" in batch:
        return batch
    xyz = batch["xyz"] * np.repeat(factor, np.diff(batch["ptr"]))[:, None]
    steering_rad = np.arctan(np.tan(batch["steering_rad"]) / factor[batch["windows"][:, -1]])
    return batch | {"xyz": xyz, "steering_rad": steering_rad}
