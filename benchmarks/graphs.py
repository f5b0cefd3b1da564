"""Measure making graphs beside scipy, Open3D and PyTorch Geometric, and graph files beside PyG's Data."""

import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch

from benchmarks.street import DEVICE, FRAMES, KEEP_INTER_CLASS, K, Row, Street, compare, milliseconds, row
from models.steering.core.batch import GraphBatch
from pipeline.graphs import graph, graph_file

CLOUDS = 4


def graph_build(street: Street) -> Row:
    """Compare making the graph of a cloud with scipy's tree and PyTorch Geometric's utilities."""
    clouds, rng = street.clouds(CLOUDS), np.random.default_rng(0)
    return compare(
        milliseconds(lambda: [graph.build(*cloud, K, KEEP_INTER_CLASS, rng) for cloud in clouds], CLOUDS),
        milliseconds(lambda: [pyg_graph(*cloud, K, KEEP_INTER_CLASS, rng) for cloud in clouds], CLOUDS),
        "ms/frame",
        f"{street.title}, k = {K}: neighbours, pruning, CSR / scipy cKDTree + PyG utilities",
    )


def pyg_graph(
    xyz: np.ndarray, cls: np.ndarray, k: int, keep_inter_class: float, rng: np.random.Generator
) -> tuple[torch.Tensor, torch.Tensor]:
    """Return the graph of `graph.build` as CSR: pointers [P+1] and neighbours [E]."""
    from torch_geometric.utils import coalesce, index_to_mask, sort_edge_index, to_undirected
    from torch_geometric.utils.sparse import index2ptr

    nodes = len(xyz)
    neighbours = torch.from_numpy(scipy_neighbours(xyz, k))
    index = torch.stack([torch.arange(nodes).repeat_interleave(neighbours.shape[1]), neighbours.flatten()])
    index = coalesce(to_undirected(index, num_nodes=nodes))
    index = index[:, index[0] < index[1]]
    inter_class = torch.from_numpy(cls[index[0]] != cls[index[1]]).nonzero()[:, 0]
    removed = rng.permutation(len(inter_class))[round(keep_inter_class * len(inter_class)) :]
    index = index[:, ~index_to_mask(inter_class[torch.from_numpy(removed)], index.shape[1])]
    index = sort_edge_index(to_undirected(index, num_nodes=nodes), num_nodes=nodes)
    return index2ptr(index[0], nodes), index[1]


def scipy_neighbours(xyz: np.ndarray, k: int) -> np.ndarray:
    """Return the k nearest neighbours of each point without the point itself, int64 [P,k]."""
    from scipy.spatial import cKDTree

    return np.asarray(cKDTree(xyz).query(xyz, k + 1, workers=torch.get_num_threads())[1])[:, 1:]


def open3d_neighbours(xyz: np.ndarray, k: int) -> np.ndarray:
    """Return the k nearest neighbours of each point without the point itself, [P,k]."""
    import open3d.core as o3c

    points = o3c.Tensor.from_numpy(xyz)
    tree = o3c.nns.NearestNeighborSearch(points)
    tree.knn_index()
    indices: np.ndarray = tree.knn_search(points, k + 1)[0].numpy()
    return indices[:, 1:]


def neighbours(street: Street, name: str, search: Callable[[np.ndarray, int], np.ndarray]) -> Row:
    """Compare nearest neighbours with an alternative's."""
    clouds = [xyz for xyz, _ in street.clouds(CLOUDS)]
    return compare(
        milliseconds(lambda: [graph.nearest(xyz, K) for xyz in clouds], CLOUDS),
        milliseconds(lambda: [search(xyz, K) for xyz in clouds], CLOUDS),
        "ms/frame",
        f"{street.title} in Morton order, k = {K}: nearest neighbours / {name}",
    )


def size(street: Street) -> Row:
    """Compare bytes on disk."""
    with tempfile.TemporaryDirectory() as folder:
        alternative = sum(path.stat().st_size for path in save(street, Path(folder), FRAMES)) / FRAMES
    with graph_file.open_graphs(street.file) as file:
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


def edge_index(batch: GraphBatch) -> torch.Tensor:
    """Return a batch's graph in PyTorch Geometric's form, int64 [2,E]."""
    node = torch.arange(len(batch.xyz), device=batch.xyz.device)
    return torch.stack([node.repeat_interleave(batch.degree.long()), batch.indices.long()])
