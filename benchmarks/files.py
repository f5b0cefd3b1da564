"""Measure graph files beside PyTorch Geometric's Data, written by torch.save."""

import tempfile
from pathlib import Path

import torch

from benchmarks.graph_network import edge_index
from benchmarks.row import DEVICE, Row, compare, milliseconds, row
from benchmarks.street import FRAMES, Street
from pipeline.train import frames


def size(street: Street) -> Row:
    """Compare bytes on disk."""
    with tempfile.TemporaryDirectory() as folder:
        alternative = sum(path.stat().st_size for path in save(street, Path(folder), FRAMES)) / FRAMES
    with frames.open_graphs(street.file) as file:
        ours = street.file.stat().st_size / len(file.frame)
    return row(ours / 1e6, alternative / 1e6, "MB/frame", f"{street.title}: graph file / PyG Data by torch.save")


def load(street: Street) -> Row:
    """Compare reading a run of frames, from files in the system's cache to a batch on the device."""
    with tempfile.TemporaryDirectory() as folder:
        paths = save(street, Path(folder), FRAMES)
        return compare(
            milliseconds(lambda: street.batch(FRAMES), FRAMES),
            milliseconds(lambda: [torch.load(path, weights_only=False).to(DEVICE) for path in paths], FRAMES),
            "ms/frame",
            f"{street.title}: {FRAMES} frames of a graph file / torch.load of PyG Data",
        )


def save(street: Street, folder: Path, count: int) -> list[Path]:
    """Write the first `count` frames, a file each: float32 points and int64 edges, as PyG's operators need them."""
    from torch_geometric.data import Data

    paths = []
    for number, frame in enumerate(street.batch(count, "cpu").blocks(1)):
        paths.append(folder / f"{number}.pt")
        # Clones: a view would save the storage of all frames.
        torch.save(Data(pos=frame.xyz.clone(), cls=frame.cls.long(), edge_index=edge_index(frame)), paths[-1])
    return paths
