import pytest
import torch

from models.steering.core import aggregate as module
from models.steering.core.aggregate import aggregate, neighbourhoods
from models.steering.spatial.edgeconv import EdgeConvLayer, centre_plus_max
from models.steering.spatial.gatv2 import GATv2Layer, attend


@pytest.mark.parametrize("loops", [False, True])
@pytest.mark.parametrize("edges", [1, 20, 10**6])
def test_chunks_have_each_node_once_with_its_neighbours(make_batch, monkeypatch, loops, edges):
    monkeypatch.setitem(module.EDGES, "cpu", edges)
    batch = make_batch([13, 0, 1, 30])
    rows = [row.tolist() for row in batch.indices.split(batch.degree.tolist())]
    expected = {node: [node] * loops + row for node, row in enumerate(rows) if row or loops}
    chunks = neighbourhoods(batch, loops=loops)
    assert sum(len(nodes) for nodes, _, _ in chunks) == len(expected)
    pairs = ((nodes.tolist(), rows.tolist()) for nodes, rows, _ in chunks)
    assert {node: row for nodes, rows in pairs for node, row in zip(nodes, rows, strict=True)} == expected
    assert all(len(nodes) == 1 or rows.numel() <= edges for nodes, rows, _ in chunks)
    assert all(valid is None for _, _, valid in chunks)


@pytest.mark.parametrize("function", [centre_plus_max, attend])
def test_gradients(make_batch, monkeypatch, function):
    monkeypatch.setitem(module.EDGES, "cpu", 10)
    batch = make_batch([9, 1])
    chunks = neighbourhoods(batch, loops=False)
    shared = [torch.randn(2, 2, dtype=torch.float64, requires_grad=True)] * (function is attend)
    x, centre = torch.randn(2, 10, 4, dtype=torch.float64).requires_grad_()
    assert torch.autograd.gradcheck(lambda *inputs: aggregate(function, chunks, *inputs), (x, centre, *shared))


@pytest.mark.parametrize("layer", [EdgeConvLayer, GATv2Layer])
def test_same_bits_each_time(make_batch, layer):
    batch = make_batch([300, 200])
    net = layer(16, 32)
    x = torch.randn(500, 16)

    def run():
        out = net(x, layer.operator(batch, torch.float32))
        return [out, *torch.autograd.grad(out.square().sum(), list(net.parameters()))]

    first = run()
    assert all(torch.equal(a, b) for _ in range(3) for a, b in zip(first, run(), strict=True))
