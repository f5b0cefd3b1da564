"""Frames of graph files as batches of tensors: read from the files, or kept in memory."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
import psutil
import torch
from torch import Tensor
from tqdm import tqdm

from pipeline.graphs.graph_file import Graphs, open_graphs

# Where frames are kept: in the memory of the GPU, in RAM, or nowhere but in the files.
Place = Literal["GPU", "RAM", "disk"]
# Factor on the measured peak of a step, for an optimiser's state, and for gaps between tensors.
RESERVE = 1.1
# Share of the free RAM that frames may take; the rest is for batches.
SPARE = 0.8
# Folder with the limits of a container's memory.
CGROUP = Path("/sys/fs/cgroup")
# Folder with an entry for each GPU of the machine.
GPUS = Path("/proc/driver/nvidia/gpus")


class Files:
    """Open graph files by path, which a process opens once for all its trainings.

    A copy in another process has none of them open.
    """

    def __init__(self, paths: Iterable[Path] = (), place: Place | None = None) -> None:
        """`paths` are those that :meth:`load` keeps in memory; it chooses the place if None."""
        self.paths = [*dict.fromkeys(paths)]
        self.place = place
        self._opened: dict[Path, Graphs] = {}

    def __getitem__(self, path: Path) -> Graphs:
        if path not in self._opened:
            self._opened[path] = open_graphs(path)
        return self._opened[path]

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"_opened": {}}

    def load(self, device: torch.device, peak: Callable[[], int] | None = None) -> None:
        """Read the files into memory, once.

        For a CPU they stay on disk: computing takes longer than reading. `peak` returns the bytes
        that a step needs on the GPU beside the frames; if None, they go to RAM.
        """
        if self.place is None:
            self.place = self._choose(peak) if device.type == "cuda" else "disk"
        if self.place == "disk":
            return
        memory = device if self.place == "GPU" else torch.device("cpu")
        for path in tqdm(self.paths, "load", unit=" drives", leave=False, disable=None):
            if not self[path].kept:
                self[path].keep(lambda rows: as_tensor(rows).to(memory))

    def _choose(self, peak: Callable[[], int] | None) -> Place:
        """Return the place for the frames of a training on a GPU."""
        size = sum(self[path].size for path in self.paths)
        ram = free_ram()
        place: Place = "RAM" if size <= SPARE * ram else "disk"
        if peak is None:
            return place

        step = int(RESERVE * peak())
        torch.cuda.empty_cache()
        card, _ = torch.cuda.mem_get_info()
        if size + step <= card:
            place = "GPU"
        free = f"{card / 1e9:.1f} GB are free on the GPU, {ram / 1e9:.1f} in RAM"
        print(
            f"{size / 1e9:.1f} GB of frames: {place}; {free}, a step takes {step / 1e9:.1f}",
            flush=True,
        )
        return place


def free_ram() -> int:
    """Return the bytes of RAM that this process may use.

    They are what the machine, or its container, has free, shared among its GPUs.
    """
    free = int(psutil.virtual_memory().available)
    limit = CGROUP / "memory.max"
    if limit.is_file() and limit.read_text().strip() != "max":
        used = int((CGROUP / "memory.current").read_text())
        lines = (CGROUP / "memory.stat").read_text().splitlines()
        cached = dict(line.split() for line in lines)["inactive_file"]  # is freed when needed
        free = min(free, int(limit.read_text()) - used + int(cached))
    gpus = len([*GPUS.glob("*")])
    return free // max(1, gpus)


def join(spans: Sequence[tuple[Graphs, int, int]], *, pin: bool = False) -> dict[str, Tensor]:
    """Read the frames [start, stop) of each file as one batch of B frames.

    The files have the same columns and place. A batch has the columns, one frame after the other,
    and for each pointer the first row of each frame and the end, int64 [B+1] on the CPU. Row
    numbers are those of the files, see :func:`number_rows`. With `pin`, columns on the CPU are in
    pinned memory, from which copies to a GPU do not wait; torch reuses it after them.
    """
    first, _, _ = spans[0]
    batch = {}
    for pointer in first.starts:
        lengths = [np.diff(file.starts[pointer][start : stop + 1]) for file, start, stop in spans]
        batch[pointer] = torch.from_numpy(np.concatenate([[0], *lengths]).cumsum())
    for name, pointer in first.pointers.items():
        pieces = []
        for file, start, stop in spans:
            rows = slice(file.starts[pointer][start], file.starts[pointer][stop])
            pieces.append(as_tensor(file.row(name, rows)))
        batch[name] = _concatenated(pieces, pin)
    return batch


def _concatenated(pieces: list[Tensor], pin: bool) -> Tensor:
    """Return tensors as one; on the CPU in pinned memory if `pin`."""
    if pieces[0].is_cuda:
        return torch.cat(pieces)
    # By numpy, whose memory has large pages: twice as fast; and torch's threads are busy with the
    # network.
    arrays = [piece.numpy() for piece in pieces]
    if not pin:
        return torch.from_numpy(np.concatenate(arrays))
    rows = sum(len(piece) for piece in pieces)
    pinned = torch.empty(rows, *pieces[0].shape[1:], dtype=pieces[0].dtype, pin_memory=True)
    np.concatenate(arrays, out=pinned.numpy(), casting="no")
    return pinned


def number_rows(batch: dict[str, Tensor], file: Graphs) -> dict[str, Tensor]:
    """Make the row numbers of a joined batch, int32, count from its first row.

    `file` names the columns: any of the batch.
    """
    for name, counted in file.refers_to.items():
        batch[name] = _unsigned(batch[name])
        first_rows = batch[file.pointers[counted]][:-1]
        for numbers, first in by_frame(batch[name], first_rows, batch[file.pointers[name]]):
            numbers += first
    return batch


def by_frame(rows: Tensor, values: Tensor, pointer: Tensor) -> Iterator[tuple[Any, Any]]:
    """Yield the rows of each frame and its value, so that rows can be changed in place.

    On a GPU, all rows and the values of each are yielded at once. `values` [B] and `pointer` [B+1]
    are on the CPU.
    """
    if not rows.is_cuda:
        frames = np.split(rows.numpy(), pointer[1:-1].tolist())
        yield from zip(frames, values.tolist(), strict=True)
        return
    # A copy from pinned memory does not wait for the GPU, nor does a known output size.
    counts = pointer.diff().pin_memory().to(rows.device, non_blocking=True)
    values = values.to(rows.dtype).pin_memory().to(rows.device, non_blocking=True)
    repeated = values.repeat_interleave(counts, output_size=len(rows))
    yield rows, repeated.view(-1, *[1] * (rows.ndim - 1))


def as_tensor(rows: np.ndarray | Tensor) -> Tensor:
    """Return rows as a tensor.

    Unsigned numbers of several bytes, for which torch lacks operators, become signed numbers with
    the same bits; :func:`_unsigned` takes them back.
    """
    if isinstance(rows, Tensor):
        return rows
    if rows.dtype.kind == "u" and rows.itemsize > 1:
        rows = rows.view(f"i{rows.itemsize}")
    return torch.from_numpy(rows)


def _unsigned(rows: Tensor) -> Tensor:
    """Return a copy of unsigned numbers that :func:`as_tensor` made signed, as int32."""
    if not rows.is_cuda:
        return torch.from_numpy(rows.numpy().view(f"u{rows.itemsize}").astype(np.int32))
    if rows.dtype == torch.int16:
        return rows.int() & 0xFFFF
    return rows.to(torch.int32, copy=True)
