"""Read frames of graph files as batches of tensors, and keep frames on a GPU."""

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor
from tqdm import tqdm

from models.steering.core.batch import SIGNS, GraphBatch, from_arrays
from models.steering.core.options import NetworkOptions
from pipeline.graphs.graph_file import Graphs, open_graphs

# Largest share of a GPU's free memory that frames take. The rest is for the steps of a training.
SHARE = 0.5
# Largest number of points of the frames that a network prepares at once, if they are several. On a
# CPU, they fit into its cache.
BLOCKS = {"cpu": 2**16, "cuda": 2**19}


class Files:
    """Graph files by path, each of which is opened when it is first needed.

    All trainings of a process share the open files. A copy that is sent to another process has no
    open files.
    """

    def __init__(self, paths: Iterable[Path] = (), in_memory: bool | None = None) -> None:
        """Store the paths of the files that :meth:`load_frames` reads into the memory of a device.

        If `in_memory` is None, :meth:`load_frames` decides whether it reads them.
        """
        self.paths = [*dict.fromkeys(paths)]
        self.in_memory = in_memory
        self._opened: dict[Path, Graphs] = {}
        # A file, and the options of a network as text → what the network prepares of its frames.
        self._prepared: dict[tuple[Path, str], np.ndarray | None] = {}

    def __getitem__(self, path: Path) -> Graphs:
        if path not in self._opened:
            self._opened[path] = open_graphs(path)
        return self._opened[path]

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"_opened": {}, "_prepared": {}}

    def read_prepared(
        self, path: Path, network: NetworkOptions, device: torch.device
    ) -> np.ndarray | None:
        """Return what a network prepares of the G frames of a file, [G, ...], or None.

        The first call computes it on a device. It is kept in RAM.
        """
        key = (path, repr(network))
        if key not in self._prepared:
            self._prepared[key] = prepare_frames(self[path], network, device)
        return self._prepared[key]

    def load_frames(self, device: torch.device) -> None:
        """Read the files into the memory of a GPU, unless they have been read already.

        Files that do not fit stay on disk, from where a thread reads ahead. For a CPU, all files
        stay there, because computing takes longer than reading.
        """
        if self.in_memory is None:
            self.in_memory = device.type == "cuda" and self._fit_gpu()
        if not self.in_memory:
            return
        for path in tqdm(self.paths, "load", unit=" drives", leave=False, disable=None):
            if not self[path].kept:
                self[path].keep_columns(lambda rows: as_tensor(rows).to(device))

    def _fit_gpu(self) -> bool:
        """Return whether the files fit into their share of the GPU's free memory."""
        size = sum(self[path].size for path in self.paths)
        torch.cuda.empty_cache()
        free, _ = torch.cuda.mem_get_info()
        if size <= SHARE * free:
            return True
        sizes = f"{size / 1e9:.1f} GB of frames, {free / 1e9:.1f} GB free on the GPU"
        print(f"{sizes}: frames stay on disk", flush=True)
        return False


def prepare_frames(
    file: Graphs, network: NetworkOptions, device: torch.device
) -> np.ndarray | None:
    """Compute what a network prepares of the frames of a file, block by block."""
    # Most networks keep the method of NetworkOptions, for which no frame need be read.
    prepares = type(network).prepare is not NetworkOptions.prepare
    if "xyz" not in file.pointers or not len(file.frame) or not prepares:
        return None
    points = int(np.diff(file.starts["ptr"]).max(initial=1))
    frames = max(1, BLOCKS[device.type] // max(1, points))
    blocks = []
    for first in range(0, len(file.frame), frames):
        stop = min(first + frames, len(file.frame))
        batch = from_arrays(number_rows(join_frames([(file, first, stop)])), device)
        assert isinstance(batch, GraphBatch)
        block = network.prepare(batch)
        if block is None:
            return None
        blocks.append(block.cpu().numpy())
    return np.concatenate(blocks)


def join_frames(
    spans: Sequence[tuple[Graphs, int, int]], *, pin: bool = False
) -> dict[str, Tensor]:
    """Read the frames [start, stop) of each file as one batch of B frames.

    All files have the same columns and are kept in the same place. The batch has each column, with
    the rows of a frame after those of the frame before. It has each pointer, too: the first row of
    each frame and the end of the last, int64 [B+1] on the CPU, and the signs of further columns.
    Numbers of rows count within a frame, as in the files, until :func:`number_rows` changes them.
    With `pin`, columns on the CPU are in pinned memory, so that copies to a GPU are asynchronous.
    torch keeps that memory until they end.
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
        batch[name] = _concatenate_rows(pieces, pin)
    for name, signs in first.signs.items():
        batch[name + SIGNS] = torch.tensor(signs, dtype=torch.float32)
    return batch


def _concatenate_rows(pieces: list[Tensor], pin: bool) -> Tensor:
    """Concatenate tensors; those on the CPU into pinned memory if `pin`."""
    if pieces[0].is_cuda:
        return torch.cat(pieces)
    # numpy is twice as fast as torch, since its memory has large pages. Also, the threads of torch
    # are busy with the network.
    arrays = [piece.numpy() for piece in pieces]
    if not pin:
        return torch.from_numpy(np.concatenate(arrays))
    rows = sum(len(piece) for piece in pieces)
    pinned = torch.empty(rows, *pieces[0].shape[1:], dtype=pieces[0].dtype, pin_memory=True)
    np.concatenate(arrays, out=pinned.numpy(), casting="no")
    return pinned


def number_rows(batch: dict[str, Tensor]) -> dict[str, Tensor]:
    """Change `indices`, which count within a frame, to int32 that count within the batch."""
    if "indices" in batch:
        batch["indices"] = _to_unsigned(batch["indices"])
        first_rows = batch["ptr"][:-1]
        for numbers, first in by_frame(batch["indices"], first_rows, batch["indices_ptr"]):
            numbers += first
    return batch


def by_frame(rows: Tensor, values: Tensor, pointer: Tensor) -> Iterator[tuple[Any, Any]]:
    """Yield the rows of each frame and its value, so that rows can be changed in place.

    On a GPU, which is slow at many small operations, the only pair is all rows, and for each row
    the value of its frame. `values` [B] and `pointer` [B+1] are on the CPU.
    """
    if not rows.is_cuda:
        frames = np.split(rows.numpy(), pointer[1:-1].tolist())
        yield from zip(frames, values.tolist(), strict=True)
        return
    # None of this waits for the GPU: copies from pinned memory are asynchronous, and with a given
    # output size, torch need not read the counts.
    counts = pointer.diff().pin_memory().to(rows.device, non_blocking=True)
    values = values.to(rows.dtype).pin_memory().to(rows.device, non_blocking=True)
    repeated = values.repeat_interleave(counts, output_size=len(rows))
    yield rows, repeated.view(-1, *[1] * (rows.ndim - 1))


def as_tensor(rows: np.ndarray | Tensor) -> Tensor:
    """Return rows as a tensor.

    Unsigned numbers of several bytes, for which torch lacks operators, become signed numbers with
    the same bits. :func:`_to_unsigned` converts them back.
    """
    if isinstance(rows, Tensor):
        return rows
    if rows.dtype.kind == "u" and rows.itemsize > 1:
        rows = rows.view(f"i{rows.itemsize}")
    return torch.from_numpy(rows)


def _to_unsigned(rows: Tensor) -> Tensor:
    """Return a copy of unsigned numbers that :func:`as_tensor` made signed, as int32."""
    if not rows.is_cuda:
        return torch.from_numpy(rows.numpy().view(f"u{rows.itemsize}").astype(np.int32))
    if rows.dtype == torch.int16:
        return rows.int() & 0xFFFF
    return rows.to(torch.int32, copy=True)
