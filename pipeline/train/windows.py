"""Read drives as batches: spans of consecutive frames with overlapping windows.

A window is `window` consecutive frames. Its target is the steering `horizon` frames after its last
frame; that frame needs a label but no graph. A span is consecutive frames that are read and encoded
once for all their windows. Frames are consecutive by KITTI frame number, never by position: a
missing frame ends a stretch.

A batch is a dict of arrays: the graphs of B frames as in pipeline/graphs/graph_file.py, and for W
windows of T frames

- windows int64 [W,T]: the frames of each window, as rows of the batch's frames.
- dt_s float32 [W,T]: time since the previous frame.
- base float32 [W]: measured value of the window's last frame, to which the network's output is
  added.
- motion float32 [B,4]: measured motion since the previous frame, with the columns of
  models/steering/core/motion.py; only with motion.
- target float32 [W,R]: the R columns of targets.py, NaN if unknown; only for labelled drives.
- scenes int64 [B]: the graph that each frame sees; only with the scene of another drive. Otherwise
  there is a graph for each frame.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from pipeline.base.errors import InputError
from pipeline.base.loop import prefetch
from pipeline.graphs.graph_file import Arrays, Graphs
from pipeline.train.frames import Files, by_frame, join, number_rows
from pipeline.train.targets import Timeline, window_values


@dataclass(frozen=True)
class Span:
    """Rows [start, stop) of timeline number `drive`.

    Its windows end at the rows start + window - 1 … stop - 1.
    """

    drive: int
    start: int
    stop: int
    # Factor on all lengths of the world.
    factor: float = 1.0
    # Whether the network gets no measured motion, and a base of 0.
    hidden: bool = False


def spans(
    timelines: Sequence[Timeline], window: int, windows: int, rng: np.random.Generator | None = None
) -> list[Span]:
    """Split all stretches into spans of at most `windows` windows of `window` frames.

    Each window is in one span. With `rng`, spans start at a random phase, so that epochs have
    different batches.
    """
    result = []
    for number, timeline in enumerate(timelines):
        for start, stop in timeline.stretches:
            phase = int(rng.integers(windows)) if rng else 0
            first_end = start + window - 1  # row of the first window's last frame
            edges = [first_end, *range(first_end + (phase or windows), stop, windows), stop]
            for end, next_end in pairwise(edges):
                if end < next_end:
                    result.append(Span(number, end - window + 1, next_end))
    return result


class BatchPart(NamedTuple):
    """The part of a batch that comes from one span."""

    # File, start and stop of the graphs that its frames see.
    graphs: tuple[Graphs, int, int]
    # Factor on the lengths of each graph.
    factor: np.ndarray
    # Number of its frames.
    frames: int
    # All arrays of the batch but the graphs. Row numbers count from the span's first frame.
    arrays: Arrays


class JoinedBatch(NamedTuple):
    """A batch before it is copied to a device."""

    # In the types of the files, with their row numbers.
    arrays: dict[str, Tensor]
    # A file that names the columns of the graphs.
    file: Graphs
    # Factor on the lengths of each graph [B].
    factor: Tensor


class Reader:
    """Batches, indexed by groups of spans; with targets if the timelines are LabelledDrives.

    A thread reads ahead, enough for a CPU, which computes longer than it reads. For a GPU, `files`
    may keep frames.
    """

    def __init__(
        self, timelines: Sequence[Timeline], window: int, files: Files | None = None
    ) -> None:
        self.timelines = timelines
        self.window = window
        self.files = files or Files()

    def batches(
        self, groups: Iterable[Sequence[Span]], device: torch.device
    ) -> Iterator[dict[str, Tensor]]:
        """Return an iterator of the groups' batches, in order, on the device of a network.

        Pointers stay on the CPU.
        """
        # For a CPU, a thread makes batches ahead. For a GPU it joins frames in pinned memory; the
        # caller's thread copies them and finishes the batch on the GPU.
        if device.type == "cpu" and self.files.place != "RAM":
            return prefetch(self.__getitem__, groups)
        join_group = partial(self._join, pin=device.type == "cuda")
        if self.files.place == "GPU":
            batches: Iterator[JoinedBatch] = map(join_group, groups)
        else:
            batches = prefetch(join_group, groups)
        return (self._finish(joined, device) for joined in batches)

    def __getitem__(self, group: Sequence[Span]) -> dict[str, Tensor]:
        """Read a group of spans as one batch on the CPU.

        Raises InputError if the drive whose scene another one gets has no window.
        """
        return self._finish(self._join(group), torch.device("cpu"))

    def _join(self, group: Sequence[Span], *, pin: bool = False) -> JoinedBatch:
        """Read a group of spans, in pinned memory if `pin`, except what is on a GPU."""
        parts = [self._read_span(span) for span in group]

        # Row numbers of a span count from its first frame, those of the batch from the first span.
        frames = 0
        graphs = 0
        for part in parts:
            part.arrays["windows"] += frames
            if "scenes" in part.arrays:
                part.arrays["scenes"] += graphs
            frames += part.frames
            graphs += len(part.factor)

        batch = join([part.graphs for part in parts], pin=pin)
        for name in parts[0].arrays:
            array = np.concatenate([part.arrays[name] for part in parts])
            batch[name] = torch.from_numpy(array)
        if pin:
            for name, values in batch.items():
                if not values.is_cuda:
                    batch[name] = values.pin_memory()

        file, _, _ = parts[0].graphs
        factor = np.concatenate([part.factor for part in parts])
        return JoinedBatch(batch, file, torch.from_numpy(factor))

    def _read_span(self, span: Span) -> BatchPart:
        """Read all arrays of a span but the graphs."""
        timeline = self.timelines[span.drive]
        file = self.files[timeline.scene]
        ends = np.arange(span.start + self.window - 1, span.stop)
        windows = ends[:, None] + np.arange(1 - self.window, 1)  # rows of the drive [W,T]
        arrays = {"windows": windows - span.start, "dt_s": timeline.dt_s[windows]}
        rows = np.arange(span.start, span.stop)
        start = span.start
        stop = span.stop
        if timeline.scene != timeline.graphs:
            # No two windows share a frame, as the same frame may see other scenes in them.
            rows = windows.ravel()
            arrays["windows"] = np.arange(rows.size).reshape(windows.shape)
            scenes = self._scenes(timeline, file, ends)
            start = scenes[0, 0]
            stop = scenes[-1, -1] + 1
            arrays["scenes"] = scenes.ravel() - start

        # A larger world gives the same image.
        larger = span.factor if "xyz" in file.pointers else 1.0
        arrays |= window_values(timeline, rows, ends, larger, span.hidden)
        factor = np.full(stop - start, larger, np.float32)
        return BatchPart((file, start, stop), factor, len(rows), arrays)

    def _scenes(self, timeline: Timeline, file: Graphs, ends: np.ndarray) -> np.ndarray:
        """Return the rows [W,T] of another drive that the windows see which end at rows `ends`.

        They are consecutive, and end at the same share of the other drive.
        """
        frames = len(file.frame)
        if frames < self.window:
            problem = f"scene: another needs a window of {self.window} frames (got {frames})"
            raise InputError(problem, file.path, "Remove the drive")
        scene_ends = np.maximum(ends * frames // len(timeline.frame), self.window - 1)
        return scene_ends[:, None] + np.arange(1 - self.window, 1)

    def _finish(self, joined: JoinedBatch, device: torch.device) -> dict[str, Tensor]:
        """Copy a batch to a device, number its rows there, and scale its points."""
        batch = joined.arrays
        for name, values in batch.items():
            if not name.endswith("ptr"):
                # A copy to a CPU must have ended, since numpy reads it.
                batch[name] = values.to(device, non_blocking=device.type == "cuda")
        number_rows(batch, joined.file)
        if "xyz" in batch:
            for points, factor in by_frame(batch["xyz"], joined.factor, batch["ptr"]):
                points *= factor
        return batch
