"""Read graph files and labels as batches: spans of consecutive frames with overlapping windows.

A window is `window` consecutive frames. Its target is the steering `horizon` frames after its last frame; that frame
needs a label but no graph. A span is consecutive frames that are read and encoded once for all their windows. Frames
are consecutive by KITTI frame number, never by position: a missing frame ends a stretch.

A batch is a dict of arrays: B frames as in pipeline/graphs/graph_file.py, and for W windows of T frames

- windows int64 [W,T] (rows of the batch's frames), dt_s float32 [W,T] (time since the previous frame), base float32 [W]
  (measured value of the window's last frame that the network's output is added to);
- with motion, motion float32 [B,4] since the previous frame: the measured steering angle, yaw rate,
  speed, and whether they were measured; the first two change sign under mirroring;
- with targets, target float32 [W,R] and valid bool [W,R] of R columns, see labelled_drive.py; 0 if unknown.
"""

from collections import defaultdict
from collections.abc import Generator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.utils.data import DataLoader, Dataset

from pipeline.graphs.graph_file import Arrays, Graphs, collate, open_graphs
from pipeline.train.labelled_drive import LabelledDrive, Timeline
from pipeline.train.loop import prefetch

AHEAD = 4  # batches that a process reads in advance


@dataclass(frozen=True)
class Span:
    """Rows [start, stop) of timeline number `drive`; its windows end at rows start+window-1 … stop-1.

    Its scenes are those of the frames `shift` rows later; the drive's first frame follows its last one.
    """

    drive: int
    start: int
    stop: int
    shift: int = 0


def random_spans(drives: Sequence[LabelledDrive], window: int, windows: int, rng: np.random.Generator) -> list[Span]:
    """Split all stretches into spans of at most `windows` windows of `window` frames; each window is in one span.

    Spans start at a random phase and are shuffled, so that epochs have different batches. Spans without a valid target
    are left out.
    """
    spans = []
    for number, drive in enumerate(drives):
        for start, stop in drive.stretches:
            last = start + window - 1  # row of the first window's last frame
            phase = int(rng.integers(windows)) or windows  # windows in the first span
            edges = [last, *range(last + phase, stop, windows), stop]
            spans += [
                Span(number, a - window + 1, b, drive.scene_shift(rng))
                for a, b in pairwise(edges)
                if a < b and drive.valid[a:b].any()
            ]
    rng.shuffle(spans)
    return spans


def spans(timelines: Sequence[Timeline], window: int, windows: int) -> list[Span]:
    """Return spans of at most `windows` windows that cover each complete window once, in order."""
    return [
        Span(number, first, min(first + windows + window - 1, stop), timeline.scene_shift())
        for number, timeline in enumerate(timelines)
        for start, stop in timeline.stretches
        for first in range(start, stop - window + 1, windows)
    ]


def read_batch(
    timelines: Sequence[Timeline], files: Mapping[int, Graphs], group: Sequence[Span], window: int
) -> Arrays:
    """Read a group of spans as one batch, with targets if the timelines are drives.

    `files`: number of a timeline → its open graph file.
    """
    columns: dict[str, list[np.ndarray]] = defaultdict(list)
    scenes = []
    before = 0  # frames of the batch before the span
    for span in group:
        timeline, file, length = timelines[span.drive], files[span.drive], span.stop - span.start
        rows, ends = slice(span.start, span.stop), slice(span.start + window - 1, span.stop)
        members = np.arange(length - window + 1)[:, None] + np.arange(window)  # [W,T]
        columns["windows"].append(members + before)
        columns["dt_s"].append(timeline.dt_s[rows][members])
        columns["base"].append(timeline.base[ends].astype(np.float32))
        if timeline.motion is not None:
            columns["motion"].append(timeline.motion[rows])
        if isinstance(timeline, LabelledDrive):
            # Targets without a label have weight 0, but 0 × NaN is NaN.
            columns["target"].append(np.nan_to_num(timeline.target[ends]).astype(np.float32))
            columns["valid"].append(timeline.valid[ends])
        before += length
        frames = len(timeline.frame)
        first = (span.start + span.shift) % frames
        parts = (first, min(first + length, frames)), (0, first + length - frames)  # the second continues at the start
        scenes += [(file, start, stop) for start, stop in parts if start < stop]
    return collate(scenes) | {name: np.concatenate(parts) for name, parts in columns.items()}


@dataclass(frozen=True)
class Step:
    """One batch: spans of frames, and how each is changed."""

    spans: Sequence[Span]
    factor: np.ndarray | None = None  # float32, one per span, of all lengths; None: lengths as they are
    hide_motion: np.ndarray | None = None  # bool, one per span: motion is not measured, and the base angle is 0


class Reader(Dataset[dict[str, Tensor]]):
    """Batches with targets, indexed by :class:`Step`; a context manager.

    They are read ahead of the network. On a CPU a thread reads, as the network is slower than any disk. On a GPU
    `workers` processes read: HDF5 serves one thread per process at a time, and numpy holds Python's lock. Files stay
    open in the process that reads them. Batches depend on the step alone.
    """

    def __init__(self, drives: Sequence[LabelledDrive], window: int, workers: int = 0) -> None:
        self._drives, self._window = drives, window
        self._opened: dict[int, Graphs] = {}
        self._files = ExitStack()
        self._epoch: list[Step] = []  # the loader's sampler; its processes live for several epochs
        options: dict[str, Any] = {"pin_memory": torch.cuda.is_available()}
        if workers:
            options |= {"prefetch_factor": AHEAD, "persistent_workers": True, "multiprocessing_context": "forkserver"}
        options["generator"] = torch.Generator()  # its own: the loader draws a number for its processes
        self._loader: Any = DataLoader(self, batch_size=None, sampler=self._epoch, num_workers=workers, **options)

    def batches(self, steps: Sequence[Step]) -> Generator[dict[str, Tensor]]:
        """Yield the steps' batches in order."""
        self._epoch[:] = steps
        yield from self._loader if self._loader.num_workers else prefetch(batch for batch in self._loader)

    def __getitem__(self, step: Step) -> dict[str, Tensor]:
        for drive in {span.drive for span in step.spans} - self._opened.keys():
            self._opened[drive] = self._files.enter_context(open_graphs(self._drives[drive].graphs))
        batch = read_batch(self._drives, self._opened, step.spans, self._window)
        lengths = [span.stop - span.start for span in step.spans]
        if step.factor is not None:
            batch = rescale(batch, np.repeat(step.factor, lengths), self._drives[0].ahead_m)
        if step.hide_motion is not None:
            hidden = np.repeat(step.hide_motion, lengths)
            batch["motion"][hidden] = 0
            batch["base"][hidden[batch["windows"][:, -1]]] = 0
        return {name: torch.from_numpy(np.ascontiguousarray(array)) for name, array in batch.items()}

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"_opened": {}, "_files": ExitStack(), "_loader": None}  # for the loader's processes

    def __enter__(self) -> "Reader":
        return self

    def __exit__(self, *_: object) -> None:
        self._loader = None  # ends its processes
        self._files.close()


def rescale(batch: Arrays, factor: np.ndarray, ahead_m: Sequence[float] = ()) -> Arrays:
    """Multiply lengths, radii and speed of each frame by `factor` [B], which is equal within a span.

    The bicycle model's tan Θ is wheelbase × curvature, and curvature is 1 / length; the yaw rate does not change.
    Images and their steering do not change: a larger world gives the same image. `ahead_m`: the edges of a path's
    ranges, as in :func:`scale_path`; none for an angle.
    """
    if "image" in batch:
        return batch
    last = factor[batch["windows"][:, -1]]
    scaled = batch | {"xyz": batch["xyz"] * np.repeat(factor, np.diff(batch["ptr"]))[:, None]}
    if ahead_m:
        scaled["base"] = batch["base"] / last
        scaled["target"], scaled["valid"] = scale_path(batch["target"], batch["valid"], ahead_m, last)
    else:
        scaled["base"] = _scale_radius(batch["base"], last)
        scaled["target"] = _scale_radius(batch["target"], last[:, None])
    if "motion" in batch:
        measured_rad, yaw_rate_radps, speed_mps, valid = batch["motion"].T
        columns = [_scale_radius(measured_rad, factor), yaw_rate_radps, speed_mps * factor, valid]
        scaled["motion"] = np.stack(columns, axis=1)
    return scaled


def scale_path(
    path_1pm: np.ndarray, valid: np.ndarray, ahead_m: Sequence[float], factor: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the path ahead [W,R] in a world `factor` [W] times as large, and where it is known.

    A range there is 1 / factor of it here, so it overlaps several ranges of the labels, whose curvature counts as
    constant within each. Where one of these is not valid, or the labels end, the path is 0 and not known.
    """
    near, far = np.array(ahead_m[:-1], np.float32), np.array(ahead_m[1:], np.float32)
    scale = factor[:, None, None]
    overlap_m = np.minimum(far[:, None] / scale, far) - np.maximum(near[:, None] / scale, near)  # [W,R,R]
    share = np.maximum(overlap_m, 0) * scale / (far - near)[:, None]
    known = (share * valid[:, None]).sum(axis=2) > 1 - 1e-4
    scaled = (share * np.where(valid, path_1pm, 0)[:, None]).sum(axis=2) / factor[:, None]
    return np.where(known, scaled, 0).astype(path_1pm.dtype), known


def _scale_radius(steering_rad: np.ndarray, factor: np.ndarray) -> np.ndarray:
    """Return the steering angle in bends with `factor` times the radius."""
    return np.arctan(np.tan(steering_rad) / factor)
