"""Connect the points of a cloud by a pruned kNN graph, or group them as PointNet++ does."""

from collections.abc import Iterable
from typing import NamedTuple

import cv2
import numpy as np
from scipy.sparse import csr_array

from pipeline.base.errors import InputError

# Parameters of OpenCV's search for nearest neighbours. Algorithm 4 is FLANN_INDEX_KDTREE_SINGLE, a
# single tree, which allows for an exact search.
_FLANN = {"algorithm": 4, "leaf_max_size": 10, "reorder": True}
# Parameters of an exact search. -1 is an unlimited number of checks, so the whole tree is searched.
_EXACT = {"checks": -1, "eps": 0.0, "sorted": True}
# Largest degree of a point, as degrees are stored as uint8. Distinct points have at most about 12 k
# neighbours, so only coinciding points have more.
_MAX_DEGREE = 255


class Graph(NamedTuple):
    """A symmetric graph on P nodes in CSR format, without self-loops.

    Edges are counted as the paper counts them: a node with k nearest neighbours has k directed
    edges, so 100 points with k = 6 have 600.
    """

    degree: np.ndarray  # uint8 [P], number of neighbours of each node
    indices: np.ndarray  # int32 [sum(degree)], neighbours of each node in turn, ascending
    edges_knn: int  # number of directed edges before pruning
    edges_kept: int  # number of directed edges after pruning


def nearest_neighbours(xyz: np.ndarray, k: int) -> np.ndarray:
    """Return the rows [P,min(k,P-1)] of the nearest other points of each point [P,3].

    The nearest point comes first.
    """
    count = len(xyz)
    k = min(k, count - 1)
    if k < 1:
        return np.empty((count, 0), np.int32)
    points = np.ascontiguousarray(xyz, np.float32)
    tree = cv2.flann_Index(points, _FLANN)  # type: ignore[attr-defined]
    neighbours, _ = tree.knnSearch(points, k + 1, params=_EXACT)

    # A point is among its own k+1 neighbours, usually as the first. It may be missing if other
    # points coincide with it. In this case, the last neighbour is dropped.
    itself = neighbours == np.arange(count, dtype=np.int32)[:, None]
    itself[~itself.any(axis=1), -1] = True
    return neighbours[~itself].reshape(count, k)


def undirected(neighbours: np.ndarray) -> csr_array:
    """Return the graph of `neighbours` [P,k] as a symmetric csr_array, uint8 [P,P].

    An entry is 2 if two points are neighbours of each other, and 1 if only one of them is a
    neighbour of the other. So an entry counts directed edges. Columns are ascending in each row.
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

    All edges within a class of `cls` [P] are kept, and a random share `keep_inter_class` of the
    edges between classes. Raises InputError if a point has more than 255 neighbours.
    """
    column = matrix.indices
    row = np.repeat(np.arange(len(cls), dtype=column.dtype), np.diff(matrix.indptr))

    # An edge has two entries, of which the first is above the diagonal. Mark the first entries of
    # the edges between classes that are not kept.
    between = np.flatnonzero((cls[row] != cls[column]) & (row < column))
    kept = rng.choice(len(between), round(keep_inter_class * len(between)), replace=False)
    removed = np.zeros(len(column), bool)
    removed[np.delete(between, kept)] = True

    # Mark the second entries of these edges, too. They are the first entries of the transposed
    # matrix, which has its entries in the same order, since the matrix is symmetric.
    first_entries = csr_array((removed, column, matrix.indptr), shape=matrix.shape)
    removed |= first_entries.T.tocsr().data

    degree = np.bincount(row[~removed], minlength=len(cls))
    if degree.max(initial=0) > _MAX_DEGREE:
        problem = f"a point has {degree.max()} neighbours (at most {_MAX_DEGREE})"
        raise InputError(problem, fix="Set a smaller k")
    # Each directed edge counts in both entries of its two points.
    edges_knn = int(matrix.data.sum()) // 2
    edges_kept = int(matrix.data[~removed].sum()) // 2
    return Graph(degree.astype(np.uint8), column[~removed], edges_knn, edges_kept)


LevelSize = tuple[int, float, int]  # number of centres, radius in metres, neighbours per centre
Grouping = tuple[np.ndarray, np.ndarray]  # rows of centres [M] and of their neighbours [M,n], int64


def levels(xyz: np.ndarray, sizes: Iterable[LevelSize], rng: np.random.Generator) -> list[Grouping]:
    """Choose centres among the points [P,3], and group the points around each centre.

    Each further level does the same with the centres of the level before. This is PointNet++'s set
    abstraction (paper eq. 1; Qi et al. 2017).
    """
    groupings = []
    # A ball takes the first points that it contains. Points are stored in Morton order, in which
    # these would be in a corner of the ball. So points are searched in random order, as in the
    # reference. The centres need no such order, since the centres chosen first are evenly spread.
    order = rng.permutation(len(xyz))
    for count, radius_m, neighbours in sizes:
        centres = farthest_points(xyz, count)
        groupings.append((centres, ball_query(xyz, centres, radius_m, neighbours, order)))
        xyz = xyz[centres]
        order = np.arange(len(xyz))
    return groupings


def farthest_points(xyz: np.ndarray, count: int) -> np.ndarray:
    """Choose points [P,3] by farthest point sampling, and return their rows, int64 [min(count,P)].

    The first row is 0. Each further point is the farthest from all points chosen before it. Of
    points that are equally far, the first is chosen.
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

    `centres` [M] are rows of the points [P,3]. `order` [P] is the permutation in which points are
    searched. A ball with fewer points repeats its first point, as in the reference. This does not
    change a maximum over the neighbours.
    """
    axes = np.ascontiguousarray(xyz[order].T, np.float64)
    members = np.empty((len(centres), neighbours), np.int64)
    for row, centre in enumerate(np.argsort(order)[centres]):
        ball = np.flatnonzero(_squared_distances(axes, centre) <= radius_m**2)[:neighbours]
        members[row] = ball[0]  # a centre is in its own ball
        members[row, : len(ball)] = ball
    return order[members]


def _squared_distances(axes: np.ndarray, centre: int) -> np.ndarray:
    """Return the squared distances [P] of points, given as `axes` [3,P], to the point `centre`.

    They are exact for stored coordinates. Points as an array [P,3] would be 4 times slower.
    """
    offsets = axes - axes[:, centre, None]
    return np.asarray((offsets**2).sum(axis=0))
