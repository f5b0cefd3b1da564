"""Read drives as batches: spans of consecutive frames with overlapping windows.

A window is `window` consecutive frames. Its target is the steering `horizon` frames after its last
frame; that frame needs a label but no graph. A span is a run of consecutive frames, which are read
and encoded once for all their windows. Frames are consecutive by KITTI frame number, never by
position: a missing frame ends a stretch.

A batch is a dict of arrays: the graphs of B frames as in pipeline/graphs/graph_file.py, and for W
windows of T frames these arrays:

- windows int64 [W,T]: the frames of each window, as numbers of the batch's frames.
- dt_s float32 [W,T]: time since the previous frame.
- base float32 [W,R]: measured values of the window's last frame, to which the network's outputs are
  added.
- motion float32 [B,4]: measured motion since the previous frame, with the columns of
  models/steering/core/motion.py. Only models with motion have it.
- target float32 [W,R]: the R columns of targets.py, NaN if unknown. Only labelled drives have it.
- prepared [B, ...]: what the network prepares of each frame, if it does, before points are scaled.
- COLUMN_signs float32 [C]: factors of a further column of the points in the mirror image.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from models.steering.core.batch import ON_CPU
from pipeline.base.loop import prefetch
from pipeline.graphs.graph_file import Arrays, Graphs
from pipeline.train.frames import Files, by_frame, join_frames, number_rows
from pipeline.train.targets import Timeline, window_values


@dataclass(frozen=True)
class Span:
    """Rows [start, stop) of timeline number `drive`.

    Its windows end at the rows start + window - 1 … stop - 1.
    """

    drive: int
    start: int
    stop: int
    # Factor by which all lengths of the world are multiplied, an augmentation.
    factor: float = 1.0
    # Whether measured motion is hidden from the network; motion and base are 0 then.
    hidden: bool = False


def split_spans(
    timelines: Sequence[Timeline], window: int, windows: int, rng: np.random.Generator | None = None
) -> list[Span]:
    """Split all stretches into spans of at most `windows` windows of `window` frames.

    Each window is in a single span. With `rng`, the first span of a stretch has a random length, so
    that epochs have different batches.
    """
    result = []
    for number, timeline in enumerate(timelines):
        for start, stop in timeline.stretches:
            # Number of windows of the first span. A phase of 0 makes it a complete span.
            phase = int(rng.integers(windows)) if rng else 0
            first_windows = phase or windows

            # A span has the windows that end at the rows [end, next_end). A stretch that is shorter
            # than a window has no span.
            first_end = start + window - 1
            edges = [first_end, *range(first_end + first_windows, stop, windows), stop]
            for end, next_end in pairwise(edges):
                if end < next_end:
                    result.append(Span(number, end - window + 1, next_end))
    return result


class BatchPart(NamedTuple):
    """The part of a batch that comes from one span."""

    # File, start and stop of its frames.
    graphs: tuple[Graphs, int, int]
    # Factor on the lengths of each frame, a value per frame.
    factor: np.ndarray
    # All arrays of the batch but the graphs. Row numbers count from the span's first frame.
    arrays: Arrays


class JoinedBatch(NamedTuple):
    """A batch before it is copied to a device."""

    # All arrays of the batch. Columns have the types of the files, and row numbers count within a
    # frame.
    arrays: dict[str, Tensor]
    # Factor on the lengths of each frame [B].
    factor: Tensor
    # Column in metres, such as xyz → its pointer.
    lengths: dict[str, str]


class Reader:
    """Reads groups of spans as batches, which have targets if the timelines are LabelledDrives.

    A thread reads ahead. This is enough on a CPU, where computing takes longer than reading. For a
    GPU, `files` may keep frames on it.
    """

    def __init__(
        self, timelines: Sequence[Timeline], window: int, files: Files | None = None
    ) -> None:
        self.timelines = timelines
        self.window = window
        self.files = files or Files()

    def read_batches(
        self, groups: Iterable[Sequence[Span]], device: torch.device
    ) -> Iterator[dict[str, Tensor]]:
        """Return an iterator over the groups' batches, in order, on the device of a network.

        Pointers and signs stay on the CPU.
        """
        # For a CPU, a thread makes complete batches ahead. For a GPU, that thread only joins frames
        # in pinned memory; the caller's thread copies them and finishes the batch on the GPU.
        # Frames that are on the GPU already need no thread.
        if device.type == "cpu":
            return prefetch(self.__getitem__, groups)
        join_group = partial(self._join_spans, device=device)
        batches: Iterator[JoinedBatch] = map(join_group, groups)
        if not self.files.in_memory:
            batches = prefetch(join_group, groups)
        return (self._finish_batch(joined, device) for joined in batches)

    def __getitem__(self, group: Sequence[Span]) -> dict[str, Tensor]:
        """Read a group of spans as one batch on the CPU."""
        cpu = torch.device("cpu")
        return self._finish_batch(self._join_spans(group, cpu), cpu)

    def _join_spans(self, group: Sequence[Span], device: torch.device) -> JoinedBatch:
        """Read a group of spans. For a GPU, arrays that are not on it are in pinned memory."""
        pin = device.type == "cuda"
        parts = [self._read_span(span, device) for span in group]

        # In a part, numbers of frames count from the first of its span. In the batch they count
        # from the first of all spans.
        frames = 0
        for part in parts:
            part.arrays["windows"] += frames
            frames += len(part.factor)

        batch = join_frames([part.graphs for part in parts], pin=pin)
        for name in parts[0].arrays:
            array = np.concatenate([part.arrays[name] for part in parts])
            batch[name] = torch.from_numpy(array)
        if pin:
            for name, values in batch.items():
                if not values.is_cuda:
                    batch[name] = values.pin_memory()

        factor = np.concatenate([part.factor for part in parts])
        file, _, _ = parts[0].graphs
        lengths = {}
        for name, pointer in file.pointers.items():
            if name == "xyz" or file.units.get(name) == "m":
                lengths[name] = pointer
        return JoinedBatch(batch, torch.from_numpy(factor), lengths)

    def _read_span(self, span: Span, device: torch.device) -> BatchPart:
        """Read all arrays of a span but the graphs."""
        timeline = self.timelines[span.drive]
        file = self.files[timeline.graphs]
        ends = np.arange(span.start + self.window - 1, span.stop)
        windows = ends[:, None] + np.arange(1 - self.window, 1)  # rows of the drive [W,T]
        arrays = {"windows": windows - span.start, "dt_s": timeline.dt_s[windows]}
        rows = np.arange(span.start, span.stop)

        # Points can be scaled. An image cannot: it is the same in a larger world.
        larger = span.factor if "xyz" in file.pointers else 1.0
        arrays |= window_values(timeline, rows, ends, larger, span.hidden)
        prepared = self.files.read_prepared(timeline.graphs, timeline.network, device)
        if prepared is not None:
            arrays["prepared"] = prepared[span.start : span.stop]
        factor = np.full(len(rows), larger, np.float32)
        return BatchPart((file, span.start, span.stop), factor, arrays)

    def _finish_batch(self, joined: JoinedBatch, device: torch.device) -> dict[str, Tensor]:
        """Copy a batch to a device, number its rows there, and scale what is in metres."""
        batch = joined.arrays
        for name, values in batch.items():
            if not name.endswith(ON_CPU):
                # A copy to the CPU is waited for, since numpy reads it next.
                batch[name] = values.to(device, non_blocking=device.type == "cuda")
        number_rows(batch)
        for name, pointer in joined.lengths.items():
            for values, factor in by_frame(batch[name], joined.factor, batch[pointer]):
                values *= factor
        return batch
