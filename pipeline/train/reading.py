"""The batches of an epoch, ready when the network wants them: read, augmented and disturbed by others than it.

By a thread where the network is on a CPU, which is slower than any disk. By processes where it is on a GPU: HDF5 lets
one thread of a process read at a time, and numpy's part needs Python's lock. What is drawn follows from a step's own
numbers, so no batch depends on who made it, or when.
"""

import time
from collections.abc import Generator, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch.utils.data import DataLoader, Dataset, Sampler

from pipeline.base.executors import default_workers
from pipeline.fitting.prefetch import prefetch
from pipeline.sections.train import Noise
from pipeline.train import frames, noise, windows
from pipeline.train.augment import Change

AHEAD = 4  # batches that each process keeps ready


@dataclass(frozen=True)
class Step:
    """What one batch is made of: runs of frames, what augmentation makes of each, seeds of the noise in each."""

    runs: tuple[windows.Span, ...]
    change: Change
    seeds: tuple[tuple[int, ...], ...]


class Steps(Dataset[dict[str, Any]]):
    """Batches with targets by their :class:`Step`. Files stay open in the process that reads them."""

    def __init__(self, drives: Sequence[windows.Drive], window: int, disturb: Noise) -> None:
        self._drives, self._window, self._noise = drives, window, disturb
        self._opened: dict[int, frames.Graphs] = {}
        self._closing = ExitStack()

    def __getitem__(self, step: Step) -> dict[str, Any]:
        """Return the arrays of a batch, as tensors: these can be pinned."""
        for drive in {run.drive for run in step.runs} - self._opened.keys():
            graphs = frames.open_graphs(self._drives[drive].graphs)
            self._opened[drive] = self._closing.enter_context(graphs)
        (batch,) = windows.examples(self._drives, [step.runs], self._window, self._opened)
        lengths = [run.stop - run.start for run in step.runs]
        batch = step.change.apply(batch, lengths)
        batch = noise.disturbed(batch, lengths, [np.random.default_rng(seed) for seed in step.seeds], self._noise)
        return {name: torch.from_numpy(np.ascontiguousarray(array)) for name, array in batch.items()}

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"_opened": {}, "_closing": None}  # open files do not travel

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__ = state | {"_closing": ExitStack()}

    def close(self) -> None:
        """Close the files that this process has opened."""
        self._closing.close()
        self._opened.clear()


class _Todo(Sampler[Step]):
    """The steps of the epoch that comes; the loader's processes live longer."""

    def __init__(self) -> None:
        self.steps: Sequence[Step] = ()

    def __iter__(self) -> Iterator[Step]:
        return iter(self.steps)

    def __len__(self) -> int:
        return len(self.steps)


class Reader:
    """Reads the batches of one training run; a context manager."""

    def __init__(self, steps: Steps, device: torch.device, workers: int | None = None) -> None:
        """`workers`: processes; 0: a thread. None: STEER_WORKERS on a GPU, a thread on a CPU."""
        self._steps, self._todo, self.waited_s = steps, _Todo(), 0.0
        if workers is None:
            workers = default_workers() if device.type == "cuda" else 0
        self._loader: DataLoader[dict[str, Any]] | None = None
        if workers:
            self._loader = DataLoader(
                steps, batch_size=None, sampler=self._todo, num_workers=workers, prefetch_factor=AHEAD,
                persistent_workers=True, pin_memory=device.type == "cuda", multiprocessing_context="forkserver",
            )  # fmt: skip

    def batches(self, steps: Sequence[Step]) -> Generator[dict[str, Any]]:
        """Yield the steps' batches in order; :attr:`waited_s` says for how long the caller waited for them."""
        self._todo.steps, self.waited_s = steps, 0.0
        read = iter(self._loader) if self._loader else prefetch(self._steps[step] for step in steps)
        try:
            for _ in steps:
                started_s = time.perf_counter()
                batch = next(read)
                self.waited_s += time.perf_counter() - started_s
                yield batch
        finally:
            if isinstance(read, Generator):
                read.close()

    def __enter__(self) -> "Reader":
        return self

    def __exit__(self, *_: object) -> None:
        self._loader = None  # ends its processes
        self._steps.close()
