"""Rows of making graphs: nearest neighbours, whole graphs, and the stage that writes them."""

import time
from collections.abc import Callable

import numpy as np
import torch

from benchmarks.rows.at_hand import FRAMES, Street
from benchmarks.rows.row import Row, alone, compare, ms
from pipeline.graphs import cloud, graph

ROUNDS_OF = 4  # frames at a time


def graph_build(street: Street) -> Row:
    """kNN + pruning + CSR."""
    clouds, k, keep = _clouds(street), street.settings["k"], street.settings["keep_inter_class"]
    rng = np.random.default_rng(0)

    def ours() -> None:
        for xyz, cls in clouds:
            graph.build(xyz, cls, k, keep, rng)

    def peer() -> None:
        for xyz, cls in clouds:
            by_pyg(xyz, cls, k, keep, rng)

    text = f"{street.points:,} points, k = {k}: graph.build / scipy's cKDTree + PyG's utilities"
    return compare(ms(ours, len(clouds)), ms(peer, len(clouds)), "ms a frame", text)


def by_pyg(
    xyz: np.ndarray, cls: np.ndarray, k: int, keep_inter_class: float, rng: np.random.Generator
) -> tuple[torch.Tensor, torch.Tensor]:
    """Return where each point's neighbours begin [P+1] and who they are [E]: the graph of `graph.build`.

    By what a user would pick: scipy's tree on all cores that torch has, then PyTorch Geometric's utilities.
    """
    from torch_geometric.utils import coalesce, index_to_mask, sort_edge_index, to_undirected
    from torch_geometric.utils.sparse import index2ptr

    nodes = len(xyz)
    neighbours = torch.from_numpy(scipy_knn(xyz, k))
    index = torch.stack([torch.arange(nodes).repeat_interleave(neighbours.shape[1]), neighbours.flatten()])
    index = coalesce(to_undirected(index, num_nodes=nodes))
    index = index[:, index[0] < index[1]]
    between = torch.from_numpy(cls[index[0]] != cls[index[1]]).nonzero()[:, 0]
    lost = between[torch.from_numpy(rng.permutation(len(between))[round(keep_inter_class * len(between)) :])]
    index = index[:, ~index_to_mask(lost, index.shape[1])]
    index = sort_edge_index(to_undirected(index, num_nodes=nodes), num_nodes=nodes)
    return index2ptr(index[0], nodes), index[1]


def scipy_knn(xyz: np.ndarray, k: int) -> np.ndarray:
    """Return each point's k nearest others, int64 [P,k]."""
    from scipy.spatial import cKDTree

    return np.asarray(cKDTree(xyz).query(xyz, k + 1, workers=torch.get_num_threads())[1])[:, 1:]


def knn_vs_scipy(street: Street) -> Row:
    """Nearest neighbours alone."""
    return _knn(street, "scipy's cKDTree", scipy_knn)


def knn_vs_open3d(street: Street) -> Row:
    """Nearest neighbours alone."""
    import open3d.core as o3c

    def search(xyz: np.ndarray, k: int) -> None:
        points = o3c.Tensor.from_numpy(xyz)
        tree = o3c.nns.NearestNeighborSearch(points)
        tree.knn_index()
        tree.knn_search(points, k + 1)

    return _knn(street, "Open3D", search)


def knn_vs_pykdtree(street: Street) -> Row:
    """Nearest neighbours alone."""
    from pykdtree.kdtree import KDTree

    return _knn(street, "pykdtree", lambda xyz, k: KDTree(xyz).query(xyz, k + 1))


def graphs_stage_fps(street: Street) -> Row:
    """The whole stage in one process, files read and written."""

    def stage() -> float:
        start = time.perf_counter()
        street.make("semantic")
        return FRAMES / (time.perf_counter() - start)

    return alone(stage, "frames/s", f"{street.points:,} points: stage graphs, one process")


def _knn(street: Street, name: str, search: Callable[[np.ndarray, int], object]) -> Row:
    clouds, k = [xyz for xyz, _ in _clouds(street)], street.settings["k"]
    return compare(
        ms(lambda: [graph.nearest(xyz, k) for xyz in clouds], len(clouds)),
        ms(lambda: [search(xyz, k) for xyz in clouds], len(clouds)),
        "ms a frame",
        f"{street.points:,} points in Morton order, k = {k}: graph.nearest / {name}",
    )


def _clouds(street: Street) -> list[cloud.Cloud]:
    arrays = street.arrays(ROUNDS_OF)
    ends = arrays["ptr"][1:-1]
    return list(zip(np.split(arrays["xyz"], ends), np.split(arrays["cls"], ends), strict=True))
