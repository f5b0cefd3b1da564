"""Connect the points of a cloud: the kNN graph with semantic pruning, or PointNet++'s
neighbourhoods.
"""

from collections.abc import Iterable
from typing import Any, NamedTuple

import cv2
import numpy as np
from scipy.sparse import csr_array

from pipeline.base.errors import InputError

# FLANN_INDEX_KDTREE_SINGLE: one tree, exact
_FLANN = {"algorithm": 4, "leaf_max_size": 10, "reorder": True}
_EXACT = {"checks": -1, "eps": 0.0, "sorted": True}  # checks = -1: unlimited


class Graph(NamedTuple):
    """A symmetric graph on P nodes as CSR without self-loops."""

    degree: np.ndarray  # uint8 [P], neighbours per node
    # int32 [sum(degree)], concatenated neighbour lists, ascending within a node
    indices: np.ndarray
    edges_knn: int  # directed kNN edges, as the paper counts them: 600 for 100 points
    edges_kept: int  # those after pruning


def nearest(xyz: np.ndarray, k: int) -> np.ndarray:
    """Return the indices [P,min(k,P-1)] of the other points nearest to each point [P,3], nearest
    first.
    """
    count = len(xyz)
    k = min(k, count - 1)
    if k < 1:
        return np.empty((count, 0), np.int32)
    points = np.ascontiguousarray(xyz, np.float32)
    neighbours, _ = cv2.flann_Index(points, _FLANN).knnSearch(points, k + 1, params=_EXACT)  # type: ignore[attr-defined]
    itself = neighbours == np.arange(count, dtype=np.int32)[:, None]  # usually the first column
    # Among coinciding points, a point may be missing from its own k+1 neighbours: then the last one
    # is dropped.
    itself[~itself.any(axis=1), -1] = True
    return neighbours[~itself].reshape(count, k)


def undirected(neighbours: np.ndarray) -> Any:
    """Return `neighbours` [P,k] as a symmetric csr_array uint8 [P,P], rows ascending: 2 if mutual,
    otherwise 1.
    """
    count, k = neighbours.shape
    starts = np.arange(count + 1, dtype=np.int32) * k
    # Transposing sorts the entries of each row without comparisons.
    directed = csr_array(
        (np.ones(count * k, np.uint8), neighbours.ravel(), starts), shape=(count, count)
    ).T.tocsr()
    return directed + directed.T.tocsr()


def prune(matrix: Any, cls: np.ndarray, keep_inter_class: float, rng: np.random.Generator) -> Graph:
    """Return the graph of an :func:`undirected` matrix [P,P] after pruning (paper section 4.2, Fig.
    3).

    Edges within a class of `cls` [P] stay; of those between classes, a random fraction
    `keep_inter_class` stays. Raises InputError if a point has more than 255 neighbours.
    """
    column = matrix.indices
    row = np.repeat(np.arange(len(cls), dtype=column.dtype), np.diff(matrix.indptr))
    # the first of the two entries of an edge
    between = np.flatnonzero((cls[row] != cls[column]) & (row < column))
    kept = rng.choice(len(between), round(keep_inter_class * len(between)), replace=False)
    removed = np.zeros(len(column), bool)
    removed[np.delete(between, kept)] = True
    # The other entry of each edge: a symmetric matrix and its transpose have their entries in the
    # same order.
    removed |= type(matrix)((removed, column, matrix.indptr), shape=matrix.shape).T.tocsr().data
    degree = np.bincount(row[~removed], minlength=len(cls))
    # only coinciding points: for distinct ones the bound is about 12 k
    if degree.max(initial=0) > 255:
        raise InputError(
            f"a point has {degree.max()} neighbours (at most 255)", fix="Set a smaller k"
        )
    edges_knn, edges_kept = (
        int(counts.sum()) // 2 for counts in (matrix.data, matrix.data[~removed])
    )
    return Graph(degree.astype(np.uint8), column[~removed], edges_knn, edges_kept)


LevelSize = tuple[int, float, int]  # centres, radius in metres, neighbours per centre
# centres [M], neighbours [M,n] in the ball around each: int64, rows of points
Grouping = tuple[np.ndarray, np.ndarray]


def levels(xyz: np.ndarray, sizes: Iterable[LevelSize], rng: np.random.Generator) -> list[Grouping]:
    """Choose and group centres of the points [P,3], then of these centres, and so on (paper eq. 1;
    Qi et al. 2017).
    """
    result = []
    # Points are stored in Morton order, so the first points of a ball would be one corner of it. In
    # the reference the order is random, hence the permutation. Later levels are in the order of
    # their choice, in which the first points are evenly spread.
    order = rng.permutation(len(xyz))
    for count, radius_m, neighbours in sizes:
        centres = farthest_points(xyz, count)
        result.append((centres, ball_query(xyz, centres, radius_m, neighbours, order)))
        xyz = xyz[centres]
        order = np.arange(len(xyz))
    return result


def farthest_points(xyz: np.ndarray, count: int) -> np.ndarray:
    """Choose points [P,3] by farthest point sampling: each is the farthest from those before, the
    first is row 0.

    Returns: indices int64 [min(count, P)] in the order of choice. Ties take the first point.
    """
    axes = np.ascontiguousarray(xyz.T, np.float64)
    chosen = np.zeros(min(count, len(xyz)), np.int64)
    distance = np.full(len(xyz), np.inf)  # squared, to the nearest chosen point
    for step in range(1, len(chosen)):
        np.minimum(distance, _squared_distances(axes, chosen[step - 1]), out=distance)
        chosen[step] = distance.argmax()
    return chosen


def ball_query(
    xyz: np.ndarray, centres: np.ndarray, radius_m: float, neighbours: int, order: np.ndarray
) -> np.ndarray:
    """Return the first `neighbours` points of the ball around each centre, int64 [M,neighbours].

    `centres` [M] are rows of the points xyz [P,3]; `order` [P] is a permutation in which points are
    searched. Balls with fewer points repeat the first, as in the reference; a maximum over the
    neighbours is not affected.
    """
    axes = np.ascontiguousarray(xyz[order].T, np.float64)
    members = np.empty((len(centres), neighbours), np.int64)
    for row, centre in enumerate(np.argsort(order)[centres]):
        ball = np.flatnonzero(_squared_distances(axes, centre) <= radius_m**2)[:neighbours]
        members[row] = ball[0]  # a centre is in its own ball
        members[row, : len(ball)] = ball
    return order[members]


def _squared_distances(axes: np.ndarray, centre: int) -> np.ndarray:
    """Return squared distances [P] of points [3,P], exact for stored coordinates. Rows of points
    are 4 times slower.
    """
    return np.asarray(((axes - axes[:, centre, None]) ** 2).sum(axis=0))
