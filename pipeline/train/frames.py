"""Frames of graph files as batches of tensors: read from the files, or kept in memory, on the GPU
or in RAM.
"""

from collections.abc import Callable, Iterable, Sequence
from operator import iadd
from pathlib import Path
from typing import Any, Literal

import numpy as np
import psutil
import torch
from torch import Tensor
from tqdm import tqdm

from pipeline.graphs.graph_file import Graphs, open_graphs

Place = Literal["GPU", "RAM", "disk"]
RESERVE = 1.1  # times the measured peak: an optimiser's state, and gaps between tensors
SPARE = 0.8  # of the free RAM: the rest is for batches
CGROUP, GPUS = Path("/sys/fs/cgroup"), Path("/proc/driver/nvidia/gpus")


class Files:
    """Open graph files by path, which a process opens once for all its trainings; another process
    gets none of them.
    """

    def __init__(self, paths: Iterable[Path] = (), place: Place | None = None) -> None:
        """`paths`: those that :meth:`load` keeps in memory; `place`: where, None: it chooses."""
        self.paths, self.place, self._opened = [*dict.fromkeys(paths)], place, dict[Path, Graphs]()

    def __getitem__(self, path: Path) -> Graphs:
        if path not in self._opened:
            self._opened[path] = open_graphs(path)
        return self._opened[path]

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"_opened": {}}

    def load(self, device: torch.device, peak: Callable[[], int] | None = None) -> None:
        """Read the files into memory, once. For a CPU they stay on disk: computing takes longer
        than reading.

        `peak` returns the bytes that a step needs on the GPU beside the frames; None: unknown, so
        they go to RAM.
        """
        self.place = self.place or (self._choose(peak) if device.type == "cuda" else "disk")
        todo = [path for path in self.paths if self.place != "disk" and not self[path].kept]
        for path in tqdm(todo, "load", unit=" drives", leave=False, disable=None):
            self[path].keep(lambda rows: tensor(rows).to(device if self.place == "GPU" else "cpu"))

    def _choose(self, peak: Callable[[], int] | None) -> Place:
        size, ram = sum(self[path].size for path in self.paths), free_ram()
        place: Place = "RAM" if size <= SPARE * ram else "disk"
        if peak:
            step = int(RESERVE * peak())
            torch.cuda.empty_cache()
            card = torch.cuda.mem_get_info()[0]
            place = "GPU" if size + step <= card else place
            free = f"{card / 1e9:.1f} GB are free on the GPU, {ram / 1e9:.1f} in RAM"
            print(
                f"{size / 1e9:.1f} GB of frames: {place}; {free}, a step takes {step / 1e9:.1f}",
                flush=True,
            )
        return place


def free_ram() -> int:
    """Return the bytes that this process may use: what the machine or its container has free,
    shared among its GPUs.
    """
    free = [int(psutil.virtual_memory().available)]
    limit, used, stat = (CGROUP / f"memory.{name}" for name in ("max", "current", "stat"))
    if limit.is_file() and (text := limit.read_text().strip()) != "max":
        # freed when needed
        cached = dict(line.split() for line in stat.read_text().splitlines())["inactive_file"]
        free.append(int(text) - int(used.read_text()) + int(cached))
    return min(free) // max(1, len([*GPUS.glob("*")]))


def join(spans: Sequence[tuple[Graphs, int, int]], *, pin: bool = False) -> dict[str, Tensor]:
    """Read the frames [start, stop) of each file as one batch of B frames. The files have the same
    columns and place.

    A batch has the columns, one frame after the other, and for each pointer the first row of each
    frame and the end, int64 [B+1] on the CPU. Row numbers are those of the files, see
    :func:`number_rows`. `pin`: columns on the CPU in pinned memory, from which copies to a GPU do
    not wait; torch reuses it after them.
    """
    first, batch = spans[0][0], dict[str, Tensor]()
    for pointer in first.starts:
        counts = [np.diff(file.starts[pointer][start : stop + 1]) for file, start, stop in spans]
        batch[pointer] = torch.from_numpy(np.concatenate([[0], *counts]).cumsum())
    for name, pointer in first.pointers.items():
        parts = [
            tensor(file.row(name, slice(*file.starts[pointer][[a, b]]))) for file, a, b in spans
        ]
        if parts[0].is_cuda:
            batch[name] = torch.cat(parts)
            continue
        # By numpy, whose memory has large pages: twice as fast; and torch's threads are busy with
        # the network.
        shape, arrays = (
            (sum(map(len, parts)), *parts[0].shape[1:]),
            [part.numpy() for part in parts],
        )
        empty = torch.empty(shape, dtype=parts[0].dtype, pin_memory=True) if pin else None
        batch[name] = torch.from_numpy(np.empty(shape, arrays[0].dtype)) if empty is None else empty
        np.concatenate(arrays, out=batch[name].numpy(), casting="no")
    return batch


def number_rows(batch: dict[str, Tensor], names: Graphs) -> dict[str, Tensor]:
    """Make a joined batch's row numbers, int32, count from its first row; `names`: a file that
    names its columns.
    """
    for name, counted in names.refers_to.items():
        rows = batch[name]
        if rows.is_cuda:
            wide = rows.int() & (0xFFFF if rows.dtype == torch.int16 else -1)
        else:
            wide = torch.from_numpy(rows.numpy().view(f"u{rows.itemsize}").astype(np.int32))
        batch[name] = per_frame(
            iadd, wide, batch[names.pointers[counted]][:-1], batch[names.pointers[name]]
        )
    return batch


def per_frame(
    operator: Callable[[Any, Any], Any], rows: Tensor, values: Tensor, pointer: Tensor
) -> Tensor:
    """Apply an operator in place to each frame's rows and its value; `values` [B], `pointer` [B+1]:
    on the CPU.
    """
    if rows.is_cuda:
        values, counts = (
            part.pin_memory().to(rows.device, non_blocking=True)
            for part in (values, pointer.diff())
        )
        repeated = values.to(rows.dtype).repeat_interleave(counts, output_size=len(rows))
        return operator(rows, repeated.view(-1, *[1] * (rows.ndim - 1)))
    for part, value in zip(
        np.split(rows.numpy(), pointer[1:-1].tolist()), values.tolist(), strict=True
    ):
        operator(part, value)
    return rows


def tensor(rows: np.ndarray | Tensor) -> Tensor:
    """Return rows as a tensor; unsigned numbers of several bytes as signed ones, for which torch
    has all operators.
    """
    if isinstance(rows, Tensor):
        return rows
    return torch.from_numpy(
        rows.view(f"i{rows.itemsize}") if rows.dtype.kind == "u" and rows.itemsize > 1 else rows
    )
