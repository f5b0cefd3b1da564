"""Read and augment the batches of an epoch ahead of the network.

On a CPU a thread reads: the network is slower than any disk. On a GPU processes read: HDF5 serves one thread per
process at a time, and numpy holds Python's lock. Random numbers depend on the step alone, so batches do not depend on
the reader.
"""

import math
import shutil
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.utils.data import DataLoader, Dataset

from pipeline.base.executors import default_workers
from pipeline.graphs import graph_file
from pipeline.train import windows
from pipeline.train.augment import rescale
from pipeline.train.labelled_drive import LabelledDrive
from pipeline.train.prefetch import prefetch

AHEAD = 4  # batches per process
Targets = Callable[[Mapping[str, Tensor]], dict[str, Tensor]]
"""Arrays of a batch → further arrays, computed where it is read."""
SHARED_MEMORY = Path("/dev/shm")  # where torch's processes put batches; 64 MB in a container by default


@dataclass(frozen=True)
class TrainStep:
    """One batch: spans of frames, and the factors of their lengths."""

    runs: tuple[windows.Span, ...]
    factor: np.ndarray | None = None  # float32, one per run; None: lengths as they are
    hide_motion: np.ndarray | None = None  # bool, one per run: motion is not measured, and the base angle is 0


class Reader(Dataset[dict[str, Any]]):
    """Batches with targets, indexed by :class:`TrainStep`; a context manager.

    Files stay open in the process that reads them.
    """

    def __init__(
        self,
        drives: Sequence[LabelledDrive],
        window: int,
        device: torch.device,
        targets: Targets | None = None,
        workers: int | None = None,
    ) -> None:
        """`workers`: processes; 0: a thread. None: STEER_WORKERS on a GPU, a thread on a CPU."""
        self._drives, self._window, self._targets = drives, window, targets
        self._opened: dict[int, graph_file.Graphs] = {}
        self._files = ExitStack()
        self._epoch: list[TrainStep] = []  # the loader's sampler; its processes live for several epochs
        if workers is None:
            workers = default_workers() if device.type == "cuda" else 0
        self._workers, self._pin = workers, device.type == "cuda"
        self._loader: DataLoader[dict[str, Any]] | None = None

    def batches(self, steps: Sequence[TrainStep]) -> Generator[dict[str, Any]]:
        """Yield the steps' batches in order."""
        self._epoch[:] = steps
        if self._workers and not self._loader and steps:
            self._start(max(steps, key=lambda step: sum(run.stop - run.start for run in step.runs)))
        if self._loader:
            yield from self._loader
        else:
            yield from prefetch(self._pinned(self[step]) for step in steps)

    def predictions(self, spans: Sequence[windows.Span], first: int) -> Generator[dict[str, Any]]:
        """Yield a batch per span, whose drives are numbered from drive `first` of this reader on."""
        return self.batches([TrainStep((replace(span, drive=span.drive + first),)) for span in spans])

    def _start(self, largest: TrainStep) -> None:
        """Start as many processes as the shared memory has space for batches; none, with a note, if it is too small."""
        batch_bytes = sum(tensor.nbytes for tensor in self[largest].values())
        free_bytes = shutil.disk_usage(SHARED_MEMORY).free if SHARED_MEMORY.is_dir() else 0
        # Half of the space, as validation's batches may be larger. Two batches are in use while others are read.
        ahead = free_bytes // 2 // batch_bytes - 2
        workers = max(0, min(self._workers, ahead))
        if ahead < self._workers * AHEAD:
            needed_gb = 2 * (self._workers * AHEAD + 2) * batch_bytes / 1e9
            readers = f"{workers} processes read" if workers else "one thread reads"
            print(
                f"note: {SHARED_MEMORY} has {free_bytes / 1e6:.0f} MB free, so {readers} ahead. {self._workers} "
                f"processes need {needed_gb:.1f} GB; in a container: docker run --shm-size={math.ceil(needed_gb)}g",
                flush=True,
            )
        self._workers = workers
        if self._workers:
            self._loader = DataLoader(
                self,
                batch_size=None,
                sampler=self._epoch,
                num_workers=self._workers,
                prefetch_factor=min(AHEAD, ahead // self._workers),
                persistent_workers=True,
                pin_memory=self._pin,
                multiprocessing_context="forkserver",
            )

    def _pinned(self, batch: dict[str, Any]) -> dict[str, Any]:
        return {name: tensor.pin_memory() for name, tensor in batch.items()} if self._pin else batch

    def __getitem__(self, step: TrainStep) -> dict[str, Any]:
        """Return the arrays of a batch as tensors, which can be pinned."""
        for drive in {run.drive for run in step.runs} - self._opened.keys():
            graphs = graph_file.open_graphs(self._drives[drive].graphs)
            self._opened[drive] = self._files.enter_context(graphs)
        (batch,) = windows.batches(self._drives, [step.runs], self._window, self._opened)
        lengths = [run.stop - run.start for run in step.runs]
        if step.factor is not None:
            batch = rescale(batch, np.repeat(step.factor, lengths), self._drives[0].ahead_m)
        if step.hide_motion is not None:
            hidden = np.repeat(step.hide_motion, lengths)
            batch["motion"][hidden] = 0
            batch["base"][hidden[batch["windows"][:, -1]]] = 0
        tensors = {name: torch.from_numpy(np.ascontiguousarray(array)) for name, array in batch.items()}
        return tensors | (self._targets(tensors) if self._targets else {})

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"_opened": {}, "_files": ExitStack(), "_loader": None}  # for the loader's processes

    def __enter__(self) -> "Reader":
        return self

    def __exit__(self, *_: object) -> None:
        self._loader = None  # ends its processes
        self._files.close()
