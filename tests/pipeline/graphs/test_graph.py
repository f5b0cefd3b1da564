import numpy as np
import pytest
from scipy.spatial import cKDTree

from pipeline.base.errors import InputError
from pipeline.graphs import graph


def _street(points: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return rng.normal(size=(points, 3)).astype(np.float32) * [10, 2, 30], rng.integers(0, 4, points).astype(np.uint8)


def _pairs(made: graph.Graph) -> set[tuple[int, int]]:
    rows = np.repeat(np.arange(len(made.degree)), made.degree)
    return set(zip(rows.tolist(), made.indices.tolist(), strict=True))


def test_nearest_equals_brute_force() -> None:
    xyz, _ = _street(300)
    xyz = xyz.astype(np.float32)
    distance = np.linalg.norm(xyz[:, None].astype(np.float64) - xyz[None], axis=2)
    np.fill_diagonal(distance, np.inf)
    assert (graph.nearest(xyz, 6) == np.argsort(distance, axis=1)[:, :6]).all()


@pytest.mark.parametrize("points", [0, 1, 2, 5])
def test_fewer_points_than_neighbours(points: int) -> None:
    xyz, cls = _street(points)
    made = graph.build(xyz, cls, 6, 1.0, np.random.default_rng(0))
    assert made.degree.tolist() == [max(points - 1, 0)] * points
    assert made.edges_knn == made.edges_kept == points * max(points - 1, 0)


def test_figure_3_counts_directed_edges() -> None:
    """Paper Fig. 3: 100 points, 600 edges before pruning."""
    xyz, cls = _street(100)
    rng = np.random.default_rng(0)
    made = graph.build(xyz, cls, 6, 0.2, rng)
    assert made.edges_knn == 600
    neighbours = cKDTree(xyz.astype(np.float32)).query(xyz.astype(np.float32), 7)[1][:, 1:]
    kept = _pairs(made)
    directed = {(i, int(j)) for i, row in enumerate(neighbours) for j in row}
    assert made.edges_kept == len(directed & kept)
    assert kept == {pair for i, j in directed if (i, j) in kept for pair in ((i, j), (j, i))}


def test_symmetric_sorted_and_without_loops() -> None:
    xyz, cls = _street(500)
    made = graph.build(xyz, cls, 6, 1.0, np.random.default_rng(0))
    pairs = _pairs(made)
    assert len(pairs) == len(made.indices) == made.degree.sum()
    assert all((j, i) in pairs and i != j for i, j in pairs)
    rows = np.split(made.indices.astype(int), np.cumsum(made.degree)[:-1])
    assert all((np.diff(row) > 0).all() for row in rows)


def test_pruning_keeps_every_edge_within_a_class_and_a_fifth_between() -> None:
    xyz, cls = _street(2000)
    whole = _pairs(graph.build(xyz, cls, 6, 1.0, np.random.default_rng(0)))
    pruned = _pairs(graph.build(xyz, cls, 6, 0.2, np.random.default_rng(0)))
    within = {(i, j) for i, j in whole if cls[i] == cls[j]}
    between = whole - within
    assert within <= pruned <= whole
    assert len(pruned - within) == 2 * round(0.2 * len(between) / 2)
    none = _pairs(graph.build(xyz, cls, 6, 0.0, np.random.default_rng(0)))
    assert none == within


def test_permuted_points_give_the_permuted_graph() -> None:
    xyz, cls = _street(200)
    order = np.random.default_rng(1).permutation(200)
    whole = _pairs(graph.build(xyz, cls, 6, 1.0, np.random.default_rng(0)))
    permuted = _pairs(graph.build(xyz[order], cls[order], 6, 1.0, np.random.default_rng(0)))
    assert {(int(order[i]), int(order[j])) for i, j in permuted} == whole


def test_a_hub_of_more_than_255_neighbours_is_refused() -> None:
    def hub(others: int) -> graph.Graph:
        named = np.zeros((others + 1, 1), np.int32)
        named[0] = 1
        return graph.prune(graph.undirected(named), np.zeros(others + 1, np.uint8), 1.0, np.random.default_rng(0))

    assert hub(255).degree[0] == 255
    with pytest.raises(InputError, match="256 neighbours"):
        hub(256)
