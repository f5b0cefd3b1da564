import itertools
import warnings

import pytest
import torch

from models.steering.core import convolutions
from models.steering.core.adjacency import normalised_adjacency, propagate
from models.steering.core.graph_network import GraphNetwork
from models.steering.spatial.gnn import GCN, GCNLayer, Options

with warnings.catch_warnings():  # PyG's own use of torch.jit is deprecated there, and not ours to mend
    warnings.simplefilter("ignore", DeprecationWarning)
    warnings.simplefilter("ignore", FutureWarning)
    from torch_geometric.nn import GCNConv

TOLERANCE = {"rtol": 0, "atol": 1e-9}


def edge_index(batch):
    return torch.stack([torch.arange(len(batch.degree)).repeat_interleave(batch.degree.long()), batch.indices])


def copy_of(layer):
    peer = GCNConv(*layer.weight.shape).double()
    peer.lin.weight.data, peer.bias.data = layer.weight.data.T.clone(), layer.bias.data.clone()
    return peer


def test_adjacency_is_kipfs(make_batch):
    batch = make_batch([13, 0, 1, 30])
    nodes = len(batch.degree)
    with_loops = torch.eye(nodes, dtype=torch.float64)
    with_loops[tuple(edge_index(batch))] = 1
    scale = with_loops.sum(1).rsqrt().diag()
    built = normalised_adjacency(batch.degree, batch.indices, torch.float64)
    torch.testing.assert_close(built.to_dense(), scale @ with_loops @ scale, **TOLERANCE)


@pytest.mark.parametrize("widths", [[3, 8], [8, 3], [3, 16, 5, 5]])
def test_equals_pyg_forward_and_gradients(make_batch, widths):
    batch = make_batch([20, 11])
    ours = [GCNLayer(inputs, outputs).double() for inputs, outputs in itertools.pairwise(widths)]
    for layer in ours:
        torch.nn.init.normal_(layer.bias)
    peers = [copy_of(layer) for layer in ours]
    x = torch.randn(31, widths[0], dtype=torch.float64, requires_grad=True)
    operator = GCNLayer.operator(batch, torch.float64)
    upstream = torch.randn(31, widths[-1], dtype=torch.float64)

    def run(layers, graph):
        h = x
        for layer in layers:
            h = layer(h, graph).tanh()
        parameters = [parameter for layer in layers for parameter in layer.parameters()]
        return h, torch.autograd.grad((h * upstream).sum(), [x, *parameters])

    h, gradients = run(ours, operator)
    h_peer, gradients_peer = run(peers, edge_index(batch))
    torch.testing.assert_close(h, h_peer, **TOLERANCE)
    by_shape = {tuple(gradient.shape): gradient for gradient in gradients_peer}
    for layer_start in range(1, len(gradients), 2):
        weight, bias = gradients[layer_start : layer_start + 2]
        peer_bias, peer_weight = gradients_peer[layer_start : layer_start + 2]
        torch.testing.assert_close(weight, peer_weight.T, **TOLERANCE)
        torch.testing.assert_close(bias, peer_bias, **TOLERANCE)
    torch.testing.assert_close(gradients[0], by_shape[tuple(x.shape)], **TOLERANCE)


def test_first_and_second_derivatives(make_batch):
    batch = make_batch([9])
    adjacency = GCNLayer.operator(batch, torch.float64)
    x = torch.randn(9, 2, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda x: propagate(adjacency, x), x)
    assert torch.autograd.gradgradcheck(lambda x: propagate(adjacency, x).square(), x)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("layers", [(8, 16), (30, 5, 12), (4,)])
@pytest.mark.parametrize("sectors", [0, 7])
@pytest.mark.parametrize("tile", [4, 30, 10**6])  # points: several of a frame, some frames, all
def test_tiles_equal_layers(make_batch, monkeypatch, dtype, layers, tile, sectors):
    """Values and gradients, of the frames and of their mirror images."""
    monkeypatch.setattr(convolutions, "TILE", tile)
    batch = make_batch([13, 0, 1, 30, 22, 7])
    torch.manual_seed(0)
    net = GCN(5, Options(layers=layers, semantics=0.7, sectors=sectors)).to(dtype)
    for layer in net.layers:
        torch.nn.init.normal_(layer.bias)
    upstream = torch.randn(2, batch.frames, 5, dtype=dtype)

    def gradients(*seen):
        return torch.autograd.grad(
            (torch.stack(seen) * upstream[: len(seen)]).sum(), list(net.parameters()), retain_graph=True
        )

    here, there = (GraphNetwork.pooled(net, side, 1)[:, 0] for side in (batch, batch.mirrored()))
    here, there = net.project(here), net.project(there)
    tolerance = TOLERANCE if dtype == torch.float64 else {"rtol": 1e-5, "atol": 1e-5}
    torch.testing.assert_close(net(batch), here, **tolerance)
    torch.testing.assert_close(net.both(batch), (here, there), **tolerance)
    torch.testing.assert_close(gradients(net(batch)), gradients(here), **tolerance)
    torch.testing.assert_close(gradients(*net.both(batch)), gradients(here, there), **tolerance)
