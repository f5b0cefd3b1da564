"""Rows of files: a frame's cloud and graph beside PyTorch Geometric's Data, written by torch.save."""

import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import torch

from benchmarks.rows.at_hand import FRAMES, Street
from benchmarks.rows.graph_network import edge_index, graph_batch
from benchmarks.rows.row import Row, compare, ms, of_medians
from models.steering.core import batch as batches


def size(street: Street) -> Row:
    """Bytes on disk; counted once."""
    with tempfile.TemporaryDirectory() as folder:
        peer = sum(path.stat().st_size for path in save(street, Path(folder), FRAMES)) / FRAMES
    ours = street.file.stat().st_size / FRAMES
    text = f"{street.points:,} points: cloud + graph in the graph file / PyG Data by torch.save"
    return of_medians(ours / 1e6, peer / 1e6, "MB a frame", text)


def load(street: Street, device: str) -> Row:
    """From a file that the system has in memory to a batch on the device, in one process."""
    with tempfile.TemporaryDirectory() as folder:
        paths = save(street, Path(folder), FRAMES)
        return compare(
            ms(lambda: batches.from_arrays(street.arrays(FRAMES)).to(device), FRAMES),
            ms(lambda: [torch.load(path, weights_only=False).to(device) for path in paths], FRAMES),
            "ms a frame",
            f"{street.points:,} points: a run of {FRAMES} frames out of a graph file / torch.load of PyG Data",
        )


def save(street: Street, folder: Path, frames: int) -> list[Path]:
    """Write each of the first frames as PyTorch Geometric's Data: float32 and int64, as its operators want them."""
    paths = []
    for number, data in enumerate(as_data(graph_batch(street, frames, "cpu"))):
        paths.append(folder / f"{number}.pt")
        torch.save(data, paths[-1])
    return paths


def as_data(batch: batches.GraphBatch) -> list[Any]:
    """Return a batch's frames as PyTorch Geometric's Data, each with memory of its own."""
    from torch_geometric.data import Data

    made = []
    for block in batch.blocks(1):  # a frame each
        made.append(Data(pos=block.xyz.clone(), cls=block.cls.long(), edge_index=edge_index(block)))
    assert len(made) == batch.frames, np.diff(batch.ptr)
    return made
