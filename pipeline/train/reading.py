"""Read the batches of an epoch ahead of the network, and change the size of their scenes together with the targets.

On a CPU a thread reads: the network is slower than any disk. On a GPU processes read: HDF5 serves one thread per
process at a time, and numpy holds Python's lock. Random numbers depend on the step alone, so batches do not depend on
the reader.
"""

from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.utils.data import DataLoader, Dataset

from pipeline.graphs.graph_file import Arrays, Graphs, open_graphs
from pipeline.train import windows
from pipeline.train.labelled_drive import LabelledDrive
from pipeline.train.prefetch import prefetch

AHEAD = 4  # batches per process


@dataclass(frozen=True)
class Step:
    """One batch: spans of frames, and the factors of their lengths."""

    spans: Sequence[windows.Span]
    factor: np.ndarray | None = None  # float32, one per span; None: lengths as they are
    hide_motion: np.ndarray | None = None  # bool, one per span: motion is not measured, and the base angle is 0


class Reader(Dataset[dict[str, Any]]):
    """Batches with targets, indexed by :class:`Step`; a context manager.

    Files stay open in the process that reads them.
    """

    def __init__(
        self,
        drives: Sequence[LabelledDrive],
        window: int,
        targets: Callable[[Mapping[str, Tensor]], dict[str, Tensor]],
        workers: int = 0,
        pin_memory: bool = False,
    ) -> None:
        """`targets`: arrays of a batch → further ones, computed where it is read; `workers`: processes, 0: a thread."""
        self._drives, self._window, self._targets = drives, window, targets
        self._opened: dict[int, Graphs] = {}
        self._files = ExitStack()
        self._epoch: list[Step] = []  # the loader's sampler; its processes live for several epochs
        options: dict[str, Any] = {}
        if workers:
            options = {"prefetch_factor": AHEAD, "persistent_workers": True, "multiprocessing_context": "forkserver"}
        options["generator"] = torch.Generator()  # its own: the loader draws a number for its processes
        self._loader: DataLoader[dict[str, Any]] | None = DataLoader(
            self, batch_size=None, sampler=self._epoch, num_workers=workers, pin_memory=pin_memory, **options
        )

    def batches(self, steps: Sequence[Step]) -> Generator[dict[str, Any]]:
        """Yield the steps' batches in order."""
        self._epoch[:] = steps
        assert self._loader, "the reader is closed"
        yield from self._loader if self._loader.num_workers else prefetch(batch for batch in self._loader)

    def __getitem__(self, step: Step) -> dict[str, Any]:
        """Return the arrays of a batch as tensors, which can be pinned."""
        for drive in {span.drive for span in step.spans} - self._opened.keys():
            self._opened[drive] = self._files.enter_context(open_graphs(self._drives[drive].graphs))
        batch = windows.read_batch(self._drives, self._opened, step.spans, self._window)
        lengths = [span.stop - span.start for span in step.spans]
        if step.factor is not None:
            batch = rescale(batch, np.repeat(step.factor, lengths), self._drives[0].ahead_m)
        if step.hide_motion is not None:
            hidden = np.repeat(step.hide_motion, lengths)
            batch["motion"][hidden] = 0
            batch["base"][hidden[batch["windows"][:, -1]]] = 0
        tensors = {name: torch.from_numpy(np.ascontiguousarray(array)) for name, array in batch.items()}
        return tensors | self._targets(tensors)

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
        scaled["base"] = scale_radius(batch["base"], last)
        scaled["target"] = scale_radius(batch["target"], last[:, None])
    if "motion" in batch:
        measured_rad, yaw_rate_radps, speed_mps, valid = batch["motion"].T
        columns = [scale_radius(measured_rad, factor), yaw_rate_radps, speed_mps * factor, valid]
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


def scale_radius(steering_rad: np.ndarray, factor: np.ndarray) -> np.ndarray:
    """Return the steering angle in bends with `factor` times the radius."""
    return np.arctan(np.tan(steering_rad) / factor)
