"""Read and augment the batches of an epoch ahead of the network.

On a CPU a thread reads: the network is slower than any disk. On a GPU processes read: HDF5 serves one thread per
process at a time, and numpy holds Python's lock. Random numbers depend on the step alone, so batches do not depend on
the reader.
"""

from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
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


@dataclass(frozen=True)
class TrainStep:
    """One batch: spans of frames, and the factors of their lengths."""

    spans: tuple[windows.Span, ...]
    factor: np.ndarray | None = None  # float32, one per span; None: lengths as they are
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
        on_gpu = device.type == "cuda"
        if workers is None:
            workers = default_workers() if on_gpu else 0
        options: dict[str, Any] = {}
        if workers:
            options = {"prefetch_factor": AHEAD, "persistent_workers": True, "multiprocessing_context": "forkserver"}
        self._workers, generator = workers, torch.Generator()  # its own: the loader draws a number for its processes
        self._loader: DataLoader[dict[str, Any]] | None = DataLoader(
            self,
            batch_size=None,
            sampler=self._epoch,
            num_workers=workers,
            pin_memory=on_gpu,
            generator=generator,
            **options,
        )

    def batches(self, steps: Sequence[TrainStep]) -> Generator[dict[str, Any]]:
        """Yield the steps' batches in order."""
        self._epoch[:] = steps
        assert self._loader, "the reader is closed"
        yield from self._loader if self._workers else prefetch(batch for batch in self._loader)

    def predictions(self, spans: Sequence[windows.Span], first: int) -> Generator[dict[str, Any]]:
        """Yield a batch per span, whose drives are numbered from drive `first` of this reader on."""
        return self.batches([TrainStep((replace(span, drive=span.drive + first),)) for span in spans])

    def __getitem__(self, step: TrainStep) -> dict[str, Any]:
        """Return the arrays of a batch as tensors, which can be pinned."""
        for drive in {span.drive for span in step.spans} - self._opened.keys():
            graphs = graph_file.open_graphs(self._drives[drive].graphs)
            self._opened[drive] = self._files.enter_context(graphs)
        (batch,) = windows.batches(self._drives, [step.spans], self._window, self._opened)
        lengths = [span.stop - span.start for span in step.spans]
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
