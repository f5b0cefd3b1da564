"""Read drives as batches: spans of consecutive frames with overlapping windows.

A window is `window` consecutive frames. Its target is the steering `horizon` frames after its last
frame; that frame needs a label but no graph. A span is consecutive frames that are read and encoded
once for all their windows. Frames are consecutive by KITTI frame number, never by position: a
missing frame ends a stretch.

A batch is a dict of arrays: B graphs as in pipeline/graphs/graph_file.py, and for W windows of T
frames

- windows int64 [W,T] (rows of the batch's frames), dt_s float32 [W,T] (time since the previous
  frame), base float32 [W] (measured value of the window's last frame that the network's output is
  added to);
- with the scene of another drive, scenes int64 [B]: the graph that each frame sees, instead of one
  graph per frame;
- with motion, motion float32 [B,4] since the previous frame: the measured steering angle, yaw rate,
  speed, and whether they were measured; the first two change sign under mirroring;
- with targets, target float32 [W,R] of R columns, see targets.py; NaN if unknown.
"""

from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from operator import imul

import numpy as np
import torch
from torch import Tensor

from pipeline.base.errors import InputError
from pipeline.base.loop import prefetch
from pipeline.graphs.graph_file import Graphs
from pipeline.train.frames import Files, join, number_rows, per_frame
from pipeline.train.targets import Timeline, window_values


@dataclass(frozen=True)
class Span:
    """Rows [start, stop) of timeline number `drive`; its windows end at rows start+window-1 …
    stop-1.
    """

    drive: int
    start: int
    stop: int
    factor: float = 1.0  # of all lengths
    hidden: bool = False  # motion is not measured, and the base angle is 0


def spans(
    timelines: Sequence[Timeline], window: int, windows: int, rng: np.random.Generator | None = None
) -> list[Span]:
    """Split all stretches into spans of at most `windows` windows of `window` frames; each window
    is in one span.

    With `rng` they start at a random phase, so that epochs have different batches.
    """
    result = []
    for number, timeline in enumerate(timelines):
        for start, stop in timeline.stretches:
            last = start + window - 1  # row of the first window's last frame
            phase = int(rng.integers(windows)) if rng else 0
            edges = [last, *range(last + (phase or windows), stop, windows), stop]
            result += [Span(number, a - window + 1, b) for a, b in pairwise(edges) if a < b]
    return result


class Reader:
    """Batches, indexed by groups of spans; with targets if the timelines are LabelledDrives.

    A thread reads ahead, enough for a CPU, which computes longer than it reads. For a GPU, `files`
    may keep frames.
    """

    def __init__(
        self, timelines: Sequence[Timeline], window: int, files: Files | None = None
    ) -> None:
        self.timelines, self.window, self.files = timelines, window, files or Files()

    def batches(
        self, groups: Iterable[Sequence[Span]], device: torch.device
    ) -> Iterator[dict[str, Tensor]]:
        """Return an iterator of the groups' batches, in order, for a network on a device; pointers
        stay on the CPU.
        """
        if device.type == "cpu" and self.files.place != "RAM":
            return prefetch(self.__getitem__, groups)
        join = partial(self._join, pin=device.type == "cuda")
        joined = map(join, groups) if self.files.place == "GPU" else prefetch(join, groups)
        return (self._finish(*batch, device) for batch in joined)

    def __getitem__(self, group: Sequence[Span]) -> dict[str, Tensor]:
        """Read a group of spans as one batch on the CPU. Raises InputError if another scene's drive
        has no window.
        """
        return self._finish(*self._join(group), torch.device("cpu"))

    def _join(
        self, group: Sequence[Span], *, pin: bool = False
    ) -> tuple[dict[str, Tensor], Graphs, Tensor]:
        """Return a batch in the types of the files, a file that names its columns, and the scale of
        each frame [B].
        """
        window = self.window
        columns: dict[str, list[np.ndarray]] = defaultdict(list)
        parts: list[tuple[Graphs, int, int]] = []
        frames = graphs = 0  # of the batch before the span
        for span in group:
            timeline, rows = self.timelines[span.drive], np.arange(span.start, span.stop)
            file, start, stop = self.files[timeline.scene], span.start, span.stop
            members = np.arange(len(rows) - window + 1)[:, None] + np.arange(window)  # [W,T]
            if timeline.scene != timeline.graphs:  # no two windows share a frame
                rows = rows[members]
                if (others := len(file.frame)) < window:
                    problem = f"scene: another needs a window of {window} frames (got {others})"
                    raise InputError(problem, file.path, "Remove the drive")
                # A window's scenes are consecutive and end at the same share of the other drive.
                last = np.maximum(rows[:, -1] * others // len(timeline.frame), window - 1)
                seen = last[:, None] + np.arange(1 - window, 1)  # [W,T]
                start, stop = seen[0, 0], seen[-1, -1] + 1
                columns["scenes"].append(seen.ravel() - start + graphs)
                rows, members = rows.ravel(), np.arange(rows.size).reshape(rows.shape)
            columns["windows"].append(members + frames)
            columns["dt_s"].append(timeline.dt_s[rows][members])
            ends = slice(span.start + window - 1, span.stop)
            # a larger world gives the same image
            larger = span.factor if "xyz" in file.pointers else 1.0
            for name, values in window_values(timeline, rows, ends, larger, span.hidden).items():
                columns[name].append(values)
            parts.append((file, start, stop))
            frames, graphs = frames + len(rows), graphs + stop - start
        batch = join(parts, pin=pin) | {
            name: torch.from_numpy(np.concatenate(part)) for name, part in columns.items()
        }
        if pin:
            batch = {
                name: rows if rows.is_cuda else rows.pin_memory() for name, rows in batch.items()
            }
        factor = np.repeat(
            [span.factor for span in group], [stop - start for _, start, stop in parts]
        )
        return batch, file, torch.from_numpy(factor.astype(np.float32))

    def _finish(
        self, batch: dict[str, Tensor], file: Graphs, factor: Tensor, device: torch.device
    ) -> dict[str, Tensor]:
        """Copy a joined batch to a device, number its rows there and scale its points."""
        ahead = device.type == "cuda"  # copies to a CPU must have ended, since numpy reads them
        batch |= {
            name: batch[name].to(device, non_blocking=ahead)
            for name in batch
            if not name.endswith("ptr")
        }
        number_rows(batch, file)
        if "xyz" in batch:
            per_frame(imul, batch["xyz"], factor, batch["ptr"])
        return batch
