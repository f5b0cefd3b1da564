"""The kNN graph of a cloud, and its semantic pruning (paper section 4.2, Fig. 3)."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from pipeline.base.errors import InputError

_FLANN = {"algorithm": 4, "leaf_max_size": 10, "reorder": True}  # FLANN_INDEX_KDTREE_SINGLE: one tree, exact
_EXACT = {"checks": -1, "eps": 0.0, "sorted": True}  # checks = -1: unlimited


@dataclass(frozen=True)
class Graph:
    """A symmetric graph on P nodes as CSR without self-loops.

    degree: uint8 [P], neighbours per node.
    indices: int32 [sum(degree)], concatenated neighbour lists, ascending within a node.
    edges_knn, edges_kept: directed kNN edges before and after pruning, as the paper counts them (600 for 100 points).
    """

    degree: np.ndarray
    indices: np.ndarray
    edges_knn: int
    edges_kept: int


def build(xyz: np.ndarray, cls: np.ndarray, k: int, keep_inter_class: float, rng: np.random.Generator) -> Graph:
    """Connect each point [P,3] to its `k` nearest, make the edges undirected, and prune edges between classes.

    Edges within a class of `cls` [P] stay. Of the edges between classes, a random fraction `keep_inter_class` stays.
    Raises InputError if a point has more than 255 neighbours.
    """
    return prune(undirected(nearest(xyz, k)), cls, keep_inter_class, rng)


def nearest(xyz: np.ndarray, k: int) -> np.ndarray:
    """Return the indices [P,min(k,P-1)] of the other points nearest to each point [P,3], nearest first."""
    count = len(xyz)
    k = min(k, count - 1)
    if k < 1:
        return np.empty((count, 0), np.int32)
    import cv2

    points = np.ascontiguousarray(xyz, np.float32)
    neighbours, _ = cv2.flann_Index(points, _FLANN).knnSearch(points, k + 1, params=_EXACT)  # type: ignore[attr-defined]
    itself = neighbours == np.arange(count, dtype=np.int32)[:, None]  # usually the first column
    # Among coinciding points, a point may be missing from its own k+1 neighbours: then the last one is dropped.
    itself[~itself.any(axis=1), -1] = True
    return neighbours[~itself].reshape(count, k)


def undirected(neighbours: np.ndarray) -> Any:
    """Return the symmetric matrix of neighbour counts: 2 where i and j are neighbours of each other, 1 where one is.

    Args:
        neighbours: [P,k], the nearest points of each point.
    Returns:
        scipy.sparse.csr_array uint8 [P,P], ascending in each row.
    """
    from scipy.sparse import csr_array

    count, k = neighbours.shape
    starts = np.arange(count + 1, dtype=np.int32) * k
    # Transposing sorts the entries of each row without comparisons.
    directed = csr_array((np.ones(count * k, np.uint8), neighbours.ravel(), starts), shape=(count, count)).T.tocsr()
    return directed + directed.T.tocsr()


def prune(matrix: Any, cls: np.ndarray, keep_inter_class: float, rng: np.random.Generator) -> Graph:
    """Return the graph of an :func:`undirected` matrix [P,P] after pruning; arguments as in :func:`build`."""
    starts, column = matrix.indptr, matrix.indices
    row = np.repeat(np.arange(len(cls), dtype=column.dtype), np.diff(starts))
    between = np.flatnonzero(cls[row] != cls[column])
    between = between[row[between] < column[between]]  # the first of the two entries of an edge
    dropped = np.ones(len(between), bool)
    dropped[rng.choice(len(between), round(keep_inter_class * len(between)), replace=False)] = False
    entry = np.arange(len(column), dtype=column.dtype)
    second = type(matrix)((entry, column, starts), shape=matrix.shape).T.tocsr().data  # (i, j) → entry (j, i)
    removed = np.concatenate([between[dropped], second[between[dropped]]])
    keep = np.ones(len(column), bool)
    keep[removed] = False
    degree = np.diff(starts) - np.bincount(row[removed], minlength=len(cls))
    if degree.max(initial=0) > 255:
        # Only coinciding points reach this: for distinct points the bound is about 12 k.
        raise InputError(f"a point has {degree.max()} neighbours (at most 255)", fix="Set a smaller k")
    return Graph(
        degree.astype(np.uint8),
        column[keep],
        edges_knn=int(matrix.data.sum()) // 2,
        edges_kept=int(matrix.data[keep].sum()) // 2,
    )
