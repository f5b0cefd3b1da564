"""Connect the points of a cloud by a pruned kNN graph."""

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

    >>> xyz = np.array([[0, 0, 10], [1, 0, 10], [3, 0, 10], [7, 0, 10]])
    >>> nearest_neighbours(xyz, k=2).tolist()
    [[1, 2], [0, 2], [1, 0], [2, 1]]
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

    Three points are neighbours of each other. The last one is of another class, so it loses both
    connections.

    >>> matrix = undirected(np.array([[1, 2], [0, 2], [1, 0]]))
    >>> cls = np.array([0, 0, 13])
    >>> graph = prune(matrix, cls, keep_inter_class=0.0, rng=np.random.default_rng(0))
    >>> graph.degree.tolist(), graph.indices.tolist()
    ([1, 1, 0], [1, 0])
    >>> graph.edges_knn, graph.edges_kept
    (6, 2)
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
