"""Read drives as batches: spans of consecutive frames with overlapping windows.

A window is `window` consecutive frames. Its target is the steering `horizon` frames after its last frame; that frame
needs a label but no graph. A span is consecutive frames that are read and encoded once for all their windows. Frames
are consecutive by KITTI frame number, never by position: a missing frame ends a stretch.

A batch is a dict of arrays: B graphs as in pipeline/graphs/graph_file.py, and for W windows of T frames

- windows int64 [W,T] (rows of the batch's frames), dt_s float32 [W,T] (time since the previous frame), base float32 [W]
  (measured value of the window's last frame that the network's output is added to);
- with the scene of another drive, scenes int64 [B]: the graph that each frame sees, instead of one graph per frame;
- with motion, motion float32 [B,4] since the previous frame: the measured steering angle, yaw rate,
  speed, and whether they were measured; the first two change sign under mirroring;
- with targets, target float32 [W,R] of R columns, see targets.py; NaN if unknown.
"""

from collections import defaultdict
from collections.abc import Generator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.utils.data import DataLoader, Dataset

from pipeline.base.errors import InputError
from pipeline.graphs.graph_file import Graphs, collate, open_graphs
from pipeline.train.loop import prefetch
from pipeline.train.targets import Timeline, window_values

AHEAD = 4  # batches that a process reads in advance


@dataclass(frozen=True)
class Span:
    """Rows [start, stop) of timeline number `drive`; its windows end at rows start+window-1 … stop-1."""

    drive: int
    start: int
    stop: int
    factor: float = 1.0  # of all lengths
    hidden: bool = False  # motion is not measured, and the base angle is 0


def spans(
    timelines: Sequence[Timeline], window: int, windows: int, rng: np.random.Generator | None = None
) -> list[Span]:
    """Split all stretches into spans of at most `windows` windows of `window` frames; each window is in one span.

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


class Reader(Dataset[dict[str, Tensor]]):
    """Batches, indexed by groups of spans; with targets if the timelines are LabelledDrives. A context manager.

    They are read ahead of the network. On a CPU a thread reads, as the network is slower than any disk. On a GPU
    `workers` processes read: HDF5 serves one thread per process at a time, and numpy holds Python's lock. Files stay
    open in the process that reads them.
    """

    def __init__(self, timelines: Sequence[Timeline], window: int, workers: int = 0) -> None:
        self.timelines, self.window = timelines, window
        self._opened: dict[Path, Graphs] = {}
        self._files = ExitStack()
        self._epoch: list[Sequence[Span]] = []  # the loader's sampler; its processes live for several epochs
        self._loader: DataLoader[Any] | None = None
        if workers:
            options: dict[str, Any] = {"num_workers": workers, "prefetch_factor": AHEAD, "persistent_workers": True}
            options |= {"pin_memory": torch.cuda.is_available(), "multiprocessing_context": "forkserver"}
            options["generator"] = torch.Generator()  # its own: the loader draws a number for its processes
            self._loader = DataLoader(self, batch_size=None, sampler=self._epoch, **options)

    def batches(self, groups: Sequence[Sequence[Span]]) -> Generator[dict[str, Tensor]]:
        """Yield the groups' batches in order."""
        self._epoch[:] = groups
        yield from self._loader if self._loader is not None else prefetch(self.__getitem__, groups)

    def __getitem__(self, group: Sequence[Span]) -> dict[str, Tensor]:
        """Read a group of spans as one batch. Raises InputError if the drive of another scene has no window."""
        for path in {self.timelines[span.drive].scene for span in group} - self._opened.keys():
            self._opened[path] = self._files.enter_context(open_graphs(path))
        window = self.window
        columns: dict[str, list[np.ndarray]] = defaultdict(list)
        parts: list[tuple[Graphs, int, int]] = []
        frames = graphs = 0  # of the batch before the span
        for span in group:
            timeline, rows = self.timelines[span.drive], np.arange(span.start, span.stop)
            file, start, stop = self._opened[timeline.scene], span.start, span.stop
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
            larger = span.factor if "xyz" in file else 1.0  # a larger world gives the same image
            for name, values in window_values(timeline, rows, ends, larger, span.hidden).items():
                columns[name].append(values)
            parts.append((file, start, stop))
            frames, graphs = frames + len(rows), graphs + stop - start
        batch = collate(parts)
        if "xyz" in batch:
            factor = np.repeat([span.factor for span in group], [stop - start for _, start, stop in parts])
            batch["xyz"] *= np.repeat(factor, np.diff(batch["ptr"])).astype(np.float32)[:, None]
        batch |= {name: np.concatenate(arrays) for name, arrays in columns.items()}
        return {name: torch.from_numpy(np.ascontiguousarray(array)) for name, array in batch.items()}

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"_opened": {}, "_files": ExitStack(), "_loader": None}  # for the loader's processes

    def __enter__(self) -> "Reader":
        return self

    def __exit__(self, *_: object) -> None:
        self._loader = None  # ends its processes
        self._files.close()
