"""Measure the graph convolutions beside PyTorch Geometric's."""

import warnings
from collections.abc import Callable
from typing import cast

import torch
from torch import Tensor, nn

from benchmarks.row import DEVICE, Row, compare, milliseconds
from benchmarks.street import Street
from models.steering.core.batch import GraphBatch
from models.steering.core.features import mean_max_pool, node_features
from models.steering.spatial.gnn import GCN, GCNLayer

FRAMES = 4  # per batch


def beside_edge_index(street: Street) -> Row:
    """Compare with GCNConv on edge_index; the normalisation is computed once per batch, for all layers."""

    def prepare(batch: GraphBatch) -> Callable[[], tuple[Tensor, ...]]:
        return lambda: normalised(batch)

    return _compare(street, "edge_index", prepare)


def beside_csr(street: Street) -> Row:
    """Compare with GCNConv on torch's sparse CSR matrix, which is made once and is not timed."""

    def prepare(batch: GraphBatch) -> Callable[[], tuple[Tensor, ...]]:
        index, weight = normalised(batch)
        shape = (len(batch.xyz), len(batch.xyz))
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", message="Sparse (CSR tensor support is in beta|invariant checks)")
            matrix = torch.sparse_coo_tensor(index.flip(0), weight, shape).coalesce().to_sparse_csr()
        return lambda: (matrix,)

    return _compare(street, "CSR", prepare)


def edge_index(batch: GraphBatch) -> Tensor:
    """Return a batch's graph in PyTorch Geometric's form, int64 [2,E]."""
    node = torch.arange(len(batch.xyz), device=batch.xyz.device)
    return torch.stack([node.repeat_interleave(batch.degree.long()), batch.indices.long()])


def normalised(batch: GraphBatch) -> tuple[Tensor, Tensor]:
    """Return edges [2,E+N] with self-loops and their weights [E+N] by Kipf's normalisation."""
    from torch_geometric.nn.conv.gcn_conv import gcn_norm

    index, weight = gcn_norm(edge_index(batch), None, len(batch.xyz))
    return index, weight


def pyg_layers(net: GCN, normalize: bool = False) -> nn.ModuleList:
    """Return PyTorch Geometric's layers with the weights of ours."""
    from torch_geometric.nn import GCNConv

    layers = nn.ModuleList()
    for ours in cast(list[GCNLayer], net.layers):
        layer = GCNConv(*ours.weight.shape, normalize=normalize)
        layer.lin.weight.data = ours.weight.data.T.clone()
        layer.bias.data = ours.bias.data.clone()
        layers.append(layer)
    return layers.to(net.read_out.weight.device)


def pooled(layers: nn.ModuleList, graph: tuple[Tensor, ...], batch: GraphBatch) -> Tensor:
    """Return the pooled node features [B, 2 width] after the layers."""
    x = node_features(batch.xyz, batch.cls, 0.0)
    for layer in layers:
        x = layer(x, *graph).relu()
    return mean_max_pool(x, batch.ptr)


def _compare(street: Street, form: str, prepare: Callable[[GraphBatch], Callable[[], tuple[Tensor, ...]]]) -> Row:
    net, batch = GCN(1).to(DEVICE), street.batch(FRAMES)
    layers, graph = pyg_layers(net), prepare(batch)
    return compare(
        milliseconds(lambda: _backward(net.pooled(batch)), FRAMES),
        milliseconds(lambda: _backward(pooled(layers, graph(), batch)), FRAMES),
        "ms/frame",
        f"{street.title}: three graph convolutions / PyG GCNConv on {form}, forward + backward",
    )


def _backward(output: Tensor) -> None:
    output.square().sum().backward()  # type: ignore[no-untyped-call]
