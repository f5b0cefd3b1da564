"""Read graph files and labels as batches: spans of consecutive frames with overlapping windows.

A window is `window` consecutive frames. Its target is the steering `horizon` frames after its last frame; that frame
needs a label but no graph. A span is consecutive frames that are read and encoded once for all their windows. Frames
are consecutive by KITTI frame number, never by position: a missing frame ends a stretch.

A batch is a dict of arrays: B graphs as in pipeline/graphs/graph_file.py, and for W windows of T frames

- windows int64 [W,T] (rows of the batch's frames), dt_s float32 [W,T] (time since the previous frame), base float32 [W]
  (measured value of the window's last frame that the network's output is added to);
- with the scene of another drive, scenes int64 [B]: the graph that each frame sees, instead of one graph per frame;
- with motion, motion float32 [B,4] since the previous frame: the measured steering angle, yaw rate,
  speed, and whether they were measured; the first two change sign under mirroring;
- with targets, target float32 [W,R] and valid bool [W,R] of R columns, see labelled_drive.py; 0 if unknown.
"""

from collections import defaultdict
from collections.abc import Generator, Mapping, Sequence
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
from pipeline.graphs.graph_file import Arrays, Graphs, collate, open_graphs
from pipeline.train.labelled_drive import LabelledDrive, Timeline
from pipeline.train.loop import prefetch

AHEAD = 4  # batches that a process reads in advance


@dataclass(frozen=True)
class Span:
    """Rows [start, stop) of timeline number `drive`; its windows end at rows start+window-1 … stop-1."""

    drive: int
    start: int
    stop: int
    factor: float = 1.0  # of all lengths
    hidden: bool = False  # motion is not measured, and the base angle is 0


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
            spans += [Span(number, a - window + 1, b) for a, b in pairwise(edges) if a < b and drive.valid[a:b].any()]
    rng.shuffle(spans)
    return spans


def spans(timelines: Sequence[Timeline], window: int, windows: int) -> list[Span]:
    """Return spans of at most `windows` windows that cover each complete window once, in order."""
    return [
        Span(number, first, min(first + windows + window - 1, stop))
        for number, timeline in enumerate(timelines)
        for start, stop in timeline.stretches
        for first in range(start, stop - window + 1, windows)
    ]


def read_batch(
    timelines: Sequence[Timeline], files: Mapping[Path, Graphs], group: Sequence[Span], window: int
) -> Arrays:
    """Read a group of spans as one batch, with targets if the timelines are drives; `files`: open graph files.

    Raises InputError if the drive of another scene is shorter than a window.
    """
    columns: dict[str, list[np.ndarray]] = defaultdict(list)
    parts: list[tuple[Graphs, int, int]] = []
    frames = graphs = 0  # of the batch before the span
    for span in group:
        timeline, rows = timelines[span.drive], np.arange(span.start, span.stop)
        file, start, stop = files[timeline.scene], span.start, span.stop
        members = np.arange(len(rows) - window + 1)[:, None] + np.arange(window)  # [W,T]
        if timeline.scene != timeline.graphs:  # no two windows share a frame
            rows = rows[members]
            if (others := len(file.frame)) < window:
                problem = f"scene: another needs a window of {window} frames (got {others})"
                raise InputError(problem, file.path, "Remove the drive")
            # A window's scenes are consecutive and end at the same share of the other drive.
            ends = np.maximum(rows[:, -1] * others // len(timeline.frame), window - 1)
            seen = ends[:, None] + np.arange(1 - window, 1)  # [W,T]
            start, stop = seen[0, 0], seen[-1, -1] + 1
            columns["scenes"].append(seen.ravel() - start + graphs)
            rows, members = rows.ravel(), np.arange(rows.size).reshape(rows.shape)
        columns["windows"].append(members + frames)
        columns["dt_s"].append(timeline.dt_s[rows][members])
        for name, values in _measured(timeline, span, rows, window, "xyz" in file).items():
            columns[name].append(values)
        parts.append((file, start, stop))
        frames, graphs = frames + len(rows), graphs + stop - start
    batch = collate(parts)
    if "xyz" in batch:
        factor = np.repeat([span.factor for span in group], [stop - start for _, start, stop in parts])
        batch["xyz"] *= np.repeat(factor, np.diff(batch["ptr"])).astype(np.float32)[:, None]
    return batch | {name: np.concatenate(arrays) for name, arrays in columns.items()}


def _measured(timeline: Timeline, span: Span, rows: np.ndarray, window: int, points: bool) -> Arrays:
    """Return motion at `rows`, and base, target and valid of a span's windows, as a network gets them.

    A larger world gives the same image, so only those of `points` are rescaled.
    """
    ends = slice(span.start + window - 1, span.stop)
    values: Arrays = {"base": timeline.base[ends].astype(np.float32)}
    if timeline.motion is not None:
        values["motion"] = timeline.motion[rows]
    if isinstance(timeline, LabelledDrive):
        # Targets without a label have weight 0, but 0 × NaN is NaN.
        values["target"] = np.nan_to_num(timeline.target[ends]).astype(np.float32)
        values["valid"] = timeline.valid[ends]
        if points and span.factor != 1:
            _rescale(values, span.factor, timeline.ahead_m)
    if span.hidden:
        values |= {name: np.zeros_like(values[name]) for name in ("motion", "base")}
    return values


class Reader(Dataset[dict[str, Tensor]]):
    """Batches with targets, indexed by groups of spans; a context manager.

    They are read ahead of the network. On a CPU a thread reads, as the network is slower than any disk. On a GPU
    `workers` processes read: HDF5 serves one thread per process at a time, and numpy holds Python's lock. Files stay
    open in the process that reads them.
    """

    def __init__(self, drives: Sequence[LabelledDrive], window: int, workers: int = 0) -> None:
        self._drives, self._window = drives, window
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
        for path in {self._drives[span.drive].scene for span in group} - self._opened.keys():
            self._opened[path] = self._files.enter_context(open_graphs(path))
        batch = read_batch(self._drives, self._opened, group, self._window)
        return {name: torch.from_numpy(np.ascontiguousarray(array)) for name, array in batch.items()}

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"_opened": {}, "_files": ExitStack(), "_loader": None}  # for the loader's processes

    def __enter__(self) -> "Reader":
        return self

    def __exit__(self, *_: object) -> None:
        self._loader = None  # ends its processes
        self._files.close()


def _rescale(values: Arrays, factor: float, ahead_m: Sequence[float]) -> None:
    """Replace motion, base, target and valid of a span by those in a world `factor` times as large.

    The bicycle model's tan Θ is wheelbase × curvature, and curvature is 1 / length; the yaw rate does not change.
    `ahead_m`: the edges of a path's ranges, as in :func:`scale_path`; none for an angle.
    """
    if ahead_m:
        values["base"] = values["base"] / factor
        values["target"], values["valid"] = scale_path(values["target"], values["valid"], ahead_m, factor)
    else:
        values |= {name: _scale_radius(values[name], factor) for name in ("base", "target")}
    if "motion" in values:
        measured_rad, yaw_rate_radps, speed_mps, valid = values["motion"].T
        columns = [_scale_radius(measured_rad, factor), yaw_rate_radps, speed_mps * factor, valid]
        values["motion"] = np.stack(columns, axis=1)


def scale_path(
    path_1pm: np.ndarray, valid: np.ndarray, ahead_m: Sequence[float], factor: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return the path ahead [W,R] in a world `factor` times as large, and where it is known.

    A range there is 1 / factor of it here, so it overlaps several ranges of the labels, whose curvature counts as
    constant within each. Where one of these is not valid, or the labels end, the path is 0 and not known.
    """
    near, far = np.array(ahead_m[:-1], np.float32), np.array(ahead_m[1:], np.float32)
    overlap_m = np.minimum(far[:, None] / factor, far) - np.maximum(near[:, None] / factor, near)  # [R,R]
    share = np.maximum(overlap_m, 0) * factor / (far - near)[:, None]
    known = (share * valid[:, None]).sum(axis=2) > 1 - 1e-4
    scaled = (share * np.where(valid, path_1pm, 0)[:, None]).sum(axis=2) / factor
    return np.where(known, scaled, 0).astype(path_1pm.dtype), known


def _scale_radius(steering_rad: np.ndarray, factor: float) -> np.ndarray:
    """Return the steering angle in bends with `factor` times the radius."""
    return np.arctan(np.tan(steering_rad) / factor)
