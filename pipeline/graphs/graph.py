"""Connect the points of a cloud by a pruned kNN graph, or group them as PointNet++ does."""

from collections.abc import Iterable
from typing import NamedTuple

import cv2
import numpy as np
from scipy.sparse import csr_array

from pipeline.base.errors import InputError

# OpenCV's nearest neighbours by one tree, FLANN_INDEX_KDTREE_SINGLE, which is exact.
_FLANN = {"algorithm": 4, "leaf_max_size": 10, "reorder": True}
# A search of the whole tree: -1 is an unlimited number of checks.
_EXACT = {"checks": -1, "eps": 0.0, "sorted": True}
# Largest number of neighbours that a degree, uint8, can hold. Distinct points have about 12 k at
# most, so that only coinciding points have more.
_MAX_DEGREE = 255


class Graph(NamedTuple):
    """A symmetric graph on P nodes as CSR without self-loops."""

    degree: np.ndarray  # uint8 [P], neighbours per node
    indices: np.ndarray  # int32 [sum(degree)], neighbours of each node in turn, ascending
    edges_knn: int  # directed kNN edges, as the paper counts them: 600 for 100 points
    edges_kept: int  # those after pruning


def nearest_neighbours(xyz: np.ndarray, k: int) -> np.ndarray:
    """Return the indices [P,min(k,P-1)] of the other points nearest to each point [P,3].

    The nearest is first.
    """
    count = len(xyz)
    k = min(k, count - 1)
    if k < 1:
        return np.empty((count, 0), np.int32)
    points = np.ascontiguousarray(xyz, np.float32)
    tree = cv2.flann_Index(points, _FLANN)  # type: ignore[attr-defined]
    neighbours, _ = tree.knnSearch(points, k + 1, params=_EXACT)

    # A point is one of its own k+1 neighbours, usually the first. Among coinciding points, it may
    # be missing: then the last neighbour is dropped.
    itself = neighbours == np.arange(count, dtype=np.int32)[:, None]
    itself[~itself.any(axis=1), -1] = True
    return neighbours[~itself].reshape(count, k)


def undirected(neighbours: np.ndarray) -> csr_array:
    """Return `neighbours` [P,k] as a symmetric csr_array uint8 [P,P]: 2 if mutual, otherwise 1.

    The entries of each row are ascending.
    """
    count, k = neighbours.shape
    starts = np.arange(count + 1, dtype=np.int32) * k
    ones = np.ones(count * k, np.uint8)
    directed = csr_array((ones, neighbours.ravel(), starts), shape=(count, count))
    # Transposing sorts the entries of each row without comparisons.
    reverse = directed.T.tocsr()
    return reverse + reverse.T.tocsr()


def prune(
    matrix: csr_array, cls: np.ndarray, keep_inter_class: float, rng: np.random.Generator
) -> Graph:
    """Return the graph of an :func:`undirected` matrix [P,P] after pruning (section 4.2, Fig. 3).

    Edges within a class of `cls` [P] stay; of those between classes, a random fraction
    `keep_inter_class` stays. Raises InputError if a point has more than 255 neighbours.
    """
    column = matrix.indices
    row = np.repeat(np.arange(len(cls), dtype=column.dtype), np.diff(matrix.indptr))

    # Draw among the edges between classes, by the first of an edge's two entries.
    between = np.flatnonzero((cls[row] != cls[column]) & (row < column))
    kept = rng.choice(len(between), round(keep_inter_class * len(between)), replace=False)
    removed = np.zeros(len(column), bool)
    removed[np.delete(between, kept)] = True

    # Remove their second entries, too: a symmetric matrix and its transpose have their entries in
    # the same order.
    first_entries = csr_array((removed, column, matrix.indptr), shape=matrix.shape)
    removed |= first_entries.T.tocsr().data

    degree = np.bincount(row[~removed], minlength=len(cls))
    if degree.max(initial=0) > _MAX_DEGREE:
        problem = f"a point has {degree.max()} neighbours (at most {_MAX_DEGREE})"
        raise InputError(problem, fix="Set a smaller k")
    edges_knn = int(matrix.data.sum()) // 2
    edges_kept = int(matrix.data[~removed].sum()) // 2
    return Graph(degree.astype(np.uint8), column[~removed], edges_knn, edges_kept)


LevelSize = tuple[int, float, int]  # centres, radius in metres, neighbours per centre
Grouping = tuple[np.ndarray, np.ndarray]  # centres [M] and their neighbours [M,n]: int64, rows


def levels(xyz: np.ndarray, sizes: Iterable[LevelSize], rng: np.random.Generator) -> list[Grouping]:
    """Choose and group centres of the points [P,3], then of these centres, and so on.

    This is PointNet++'s set abstraction (paper eq. 1; Qi et al. 2017).
    """
    groupings = []
    # Points are stored in Morton order, so the first points of a ball would be one corner of it. In
    # the reference the order is random, hence the permutation. Later levels are in the order of
    # their choice, in which the first points are evenly spread.
    order = rng.permutation(len(xyz))
    for count, radius_m, neighbours in sizes:
        centres = farthest_points(xyz, count)
        groupings.append((centres, ball_query(xyz, centres, radius_m, neighbours, order)))
        xyz = xyz[centres]
        order = np.arange(len(xyz))
    return groupings


def farthest_points(xyz: np.ndarray, count: int) -> np.ndarray:
    """Choose points [P,3] by farthest point sampling: indices int64 [min(count, P)].

    The first is row 0, and each other one is the farthest from those before it. Ties take the first
    point.
    """
    axes = np.ascontiguousarray(xyz.T, np.float64)
    chosen = np.zeros(min(count, len(xyz)), np.int64)
    nearest_m2 = np.full(len(xyz), np.inf)  # squared distances to the nearest chosen point
    for step in range(1, len(chosen)):
        np.minimum(nearest_m2, _squared_distances(axes, chosen[step - 1]), out=nearest_m2)
        chosen[step] = nearest_m2.argmax()
    return chosen


def ball_query(
    xyz: np.ndarray, centres: np.ndarray, radius_m: float, neighbours: int, order: np.ndarray
) -> np.ndarray:
    """Return the first `neighbours` points of the ball around each centre, int64 [M,neighbours].

    `centres` [M] are rows of the points [P,3]; `order` [P] is the permutation in which points are
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
    """Return the squared distances [P] of points [3,P] to one of them.

    They are exact for stored coordinates. An array [P,3] would be 4 times slower.
    """
    offsets = axes - axes[:, centre, None]
    return np.asarray((offsets**2).sum(axis=0))
