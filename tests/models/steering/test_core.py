"""Batches, node features, pooling, sparse products and chunks of neighbours."""

import math
from itertools import pairwise
from typing import Any

import pytest
import torch

from models.steering.core import aggregate as module
from models.steering.core.aggregate import aggregate, neighbourhoods
from models.steering.core.features import (
    FEATURE_MIRROR_SIGNS,
    GEOMETRY,
    mean_max_pool,
    node_features,
    sector_max_pool,
)
from models.steering.spatial.edgeconv import EdgeConvLayer, centre_plus_max
from models.steering.spatial.gatv2 import GATv2Layer, attend
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


def test_pooling_by_sector_equals_brute_force_and_mirroring_reverses_it() -> None:
    """Five sectors of 18 degrees; points beside them belong to the outermost ones."""
    batch: Any = frames.batch([30, 0, 1, 17])
    x = torch.rand(48, 3, dtype=torch.float64)
    x[3] = 0
    batch.xyz[:5, 0] = 0
    expected = torch.zeros(4, 5, 3, dtype=torch.float64)
    for frame, (start, stop) in enumerate(pairwise(batch.ptr.tolist())):
        for point in range(start, stop):
            right, _, ahead = batch.xyz[point].tolist()
            sector = min(4, max(0, math.floor((math.degrees(math.atan2(right, ahead)) + 45) / 18)))
            expected[frame, sector] = torch.maximum(expected[frame, sector], x[point])
    pooled = sector_max_pool(x, batch.xyz, batch.ptr, 5).view(4, 5, 3)
    assert torch.equal(pooled, expected)
    assert torch.equal(sector_max_pool(x, batch.mirrored().xyz, batch.ptr, 5).view(4, 5, 3), pooled.flip(1))


def test_adjacency_is_kipfs() -> None:
    batch: Any = frames.batch(COUNTS)
    with_loops = frames.dense(batch) + torch.eye(sum(COUNTS))
    scale = with_loops.sum(1).rsqrt().diag()
    built = normalised_adjacency(batch.degree, batch.indices, torch.float64)
    torch.testing.assert_close(built.to_dense(), scale @ with_loops @ scale, rtol=0, atol=1e-9)


@pytest.mark.parametrize("loops", [False, True])
@pytest.mark.parametrize("edges", [1, 20, 10**6])
def test_chunks_have_each_node_once_with_its_neighbours(
    monkeypatch: pytest.MonkeyPatch, loops: bool, edges: int
) -> None:
    monkeypatch.setitem(module.EDGES, "cpu", edges)
    batch: Any = frames.batch(COUNTS)
    rows = [row.tolist() for row in batch.indices.split(batch.degree.tolist())]
    expected = {node: [node] * loops + row for node, row in enumerate(rows) if row or loops}
    chunks = neighbourhoods(batch, loops=loops)
    assert sum(len(nodes) for nodes, _, _ in chunks) == len(expected)
    pairs = ((nodes.tolist(), rows.tolist()) for nodes, rows, _ in chunks)
    assert {node: row for nodes, rows in pairs for node, row in zip(nodes, rows, strict=True)} == expected
    assert all(len(nodes) == 1 or rows.numel() <= edges for nodes, rows, _ in chunks)


@pytest.mark.parametrize("function", [centre_plus_max, attend])
def test_gradients_of_aggregates(monkeypatch: pytest.MonkeyPatch, function: Any) -> None:
    monkeypatch.setitem(module.EDGES, "cpu", 10)
    batch: Any = frames.batch([9, 1])
    chunks = neighbourhoods(batch, loops=False)
    shared = [torch.randn(2, 2, dtype=torch.float64, requires_grad=True)] * (function is attend)
    x, centre = torch.randn(2, 10, 4, dtype=torch.float64).requires_grad_()
    assert torch.autograd.gradcheck(lambda *inputs: aggregate(function, chunks, *inputs), (x, centre, *shared))


@pytest.mark.parametrize("layer", [EdgeConvLayer, GATv2Layer])
def test_same_bits_each_time(layer: Any) -> None:
    batch, net, x = frames.batch([300, 200]), layer(16, 32), torch.randn(500, 16)

    def run() -> list[torch.Tensor]:
        out = net(x, layer.operator(batch, torch.float32))
        return [out, *torch.autograd.grad(out.square().sum(), list(net.parameters()))]

    first = run()
    assert all(torch.equal(a, b) for _ in range(3) for a, b in zip(first, run(), strict=True))
