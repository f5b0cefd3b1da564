"""Batches, node features, pooling, and the sparse matrix of a graph."""

from typing import Any

import torch

from models.steering.core.features import FEATURE_MIRROR_SIGNS, GEOMETRY, mean_max_pool, node_features
from models.steering.spatial.gnn import normalised_adjacency
from pipeline.camera import classes
from tests.models.steering import frames

COUNTS = [13, 0, 1, 30]


def test_edge_index_has_both_directions_of_each_edge() -> None:
    batch: Any = frames.batch(COUNTS)
    rows = batch.indices.split(batch.degree.tolist())
    expected = [(other, node) for node, row in enumerate(rows) for other in row.tolist()]
    assert batch.edge_index.dtype == torch.int64
    assert batch.edge_index.T.tolist() == [list(pair) for pair in expected]
    assert {(b, a) for a, b in expected} == set(expected)


def test_classes_enter_in_proportion_to_semantics() -> None:
    batch: Any = frames.batch([40])
    none, half, full = (node_features(batch.xyz, batch.cls, weight) for weight in (0.0, 0.5, 1.0))
    assert torch.equal(none[:, :GEOMETRY], full[:, :GEOMETRY])
    assert not none[:, GEOMETRY:].any()
    assert torch.equal(half[:, GEOMETRY:], full[:, GEOMETRY:] / 2)
    known = batch.cls < classes.COUNT
    assert torch.equal(full[known, GEOMETRY:].argmax(1), batch.cls[known].long())
    assert torch.equal(full[:, GEOMETRY:].sum(1), known.double())  # void has no class
    mirrored = node_features(batch.mirrored().xyz, batch.cls, 1.0)
    assert torch.equal(mirrored, full * torch.tensor(FEATURE_MIRROR_SIGNS))


def test_pooling_is_mean_and_max_of_each_frame() -> None:
    x, ptr = torch.tensor([[1.0, -4.0], [3.0, -2.0], [5.0, -9.0]]), torch.tensor([0, 2, 2, 3])
    assert mean_max_pool(x, ptr).tolist() == [[2, -3, 3, -2], [0, 0, 0, 0], [5, -9, 5, -9]]
    inputs = torch.randn(3, 2, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda x: mean_max_pool(x, ptr), inputs)


def test_adjacency_is_kipfs() -> None:
    batch: Any = frames.batch(COUNTS)
    with_loops = frames.dense(batch) + torch.eye(sum(COUNTS))
    scale = with_loops.sum(1).rsqrt().diag()
    built = normalised_adjacency(batch.degree, batch.indices, torch.float64)
    torch.testing.assert_close(built.to_dense(), scale @ with_loops @ scale, rtol=0, atol=1e-9)
