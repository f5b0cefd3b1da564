"""The kNN graph of a cloud, and its semantic pruning (paper section 4.2, Fig. 3)."""

from dataclasses import dataclass

import numpy as np

from pipeline.base.errors import InputError


@dataclass(frozen=True)
class Graph:
    """A symmetric graph on P nodes as CSR without self-loops.

    degree: uint8 [P], neighbours per node.
    indices: uint16 or uint32 [sum(degree)], neighbour lists one after the other, ascending within a node.
    edges_knn, edges_kept: directed kNN edges (the paper counts these: 600 for 100 points) before and after pruning.
    """

    degree: np.ndarray
    indices: np.ndarray
    edges_knn: int
    edges_kept: int


def build(xyz: np.ndarray, cls: np.ndarray, k: int, keep_inter_class: float, rng: np.random.Generator) -> Graph:
    """Connect each point [P,3] to its `k` nearest, make the edges undirected, and prune those between classes.

    Edges within a class of `cls` [P] stay; of those between classes, a fraction `keep_inter_class`, drawn by `rng`.
    """
    count = len(xyz)
    neighbours = nearest(xyz, k)  # [P,k']
    source = np.repeat(np.arange(count, dtype=np.int64), neighbours.shape[1])
    target = neighbours.reshape(-1).astype(np.int64)
    pair = np.minimum(source, target) * count + np.maximum(source, target)
    # Two points that choose each other make one pair of multiplicity 2.
    pair, multiplicity = np.unique(pair, return_counts=True)
    a, b = pair // max(count, 1), pair % max(count, 1)
    keep = _keep(cls[a] == cls[b], keep_inter_class, rng)
    a, b = a[keep], b[keep]
    degree, indices = csr(a, b, count)
    return Graph(
        degree, indices.astype(index_dtype(count)), edges_knn=len(source), edges_kept=int(multiplicity[keep].sum())
    )


def index_dtype(nodes: int) -> type[np.unsignedinteger]:
    """Return the smallest type that numbers so many nodes."""
    return np.uint16 if nodes <= 65_535 else np.uint32


def nearest(xyz: np.ndarray, k: int) -> np.ndarray:
    """Return the indices [P,min(k,P-1)] of each point's nearest other points [P,3], nearest first."""
    count = len(xyz)
    k = min(k, count - 1)
    if k < 1:
        return np.empty((count, 0), np.int64)
    import open3d.core as o3c

    points = o3c.Tensor.from_numpy(np.ascontiguousarray(xyz, np.float32))
    search = o3c.nns.NearestNeighborSearch(points)
    search.knn_index()
    neighbours = search.knn_search(points, k + 1)[0].numpy()  # [P,k+1], mostly the point itself first
    own = neighbours == np.arange(count)[:, None]
    # Where points coincide, a point may not find itself among k+1: then its last neighbour goes.
    own[~own.any(axis=1), -1] = True
    return neighbours[~own].reshape(count, k)


def _keep(same_class: np.ndarray, keep_inter_class: float, rng: np.random.Generator) -> np.ndarray:
    keep = same_class.copy()
    between = np.flatnonzero(~same_class)
    keep[rng.choice(between, round(keep_inter_class * len(between)), replace=False)] = True
    return keep


def csr(a: np.ndarray, b: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return degree uint8 [count] and indices [2E] of the graph whose edges join nodes a [E] and b [E], each once.

    Raises InputError if a node has more than 255 neighbours.
    """
    row, column = np.concatenate([a, b]), np.concatenate([b, a])
    order = np.argsort(row * count + column)
    degree = np.bincount(row, minlength=count)
    if degree.max(initial=0) > 255:
        # Only many coinciding points can do this; k nearest distinct points bound it by about 12 k.
        raise InputError(f"a point has {degree.max()} neighbours, more than 255: use a smaller k")
    return degree.astype(np.uint8), column[order]
