"""Rows of the graph network: its layers beside PyTorch Geometric's, and beside their dense part alone."""

import copy
import warnings
from collections.abc import Callable
from typing import Any, cast

import torch
from torch import Tensor, nn

from benchmarks.rows.at_hand import Street
from benchmarks.rows.row import Row, compare, ms
from models.steering.core import batch as batches
from models.steering.core.features import NODE_FEATURES, mean_max_pool, node_features
from models.steering.spatial.gnn import GCN, GCNLayer

WIDTHS = (32, 32, 64)
FRAMES = 4  # of a batch


def vs_pyg_edge_index(street: Street, device: str) -> Row:
    """The peer normalises once for all layers."""
    return _vs_pyg(street, device, "edge_index", lambda index, weight, nodes: (index, weight))


def vs_pyg_csr(street: Street, device: str) -> Row:
    """The peer's matrix is torch's CSR, made once for all batches."""

    def csr(index: Tensor, weight: Tensor, nodes: int) -> tuple[Tensor]:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", message="Sparse (CSR tensor support is in beta|invariant checks)")
            return (torch.sparse_coo_tensor(index.flip(0), weight, (nodes, nodes)).coalesce().to_sparse_csr(),)

    return _vs_pyg(street, device, "CSR", csr)


def vs_linear(street: Street, device: str) -> Row:
    """The peer is the same network without its graph: what is left are features, dense layers and pooling."""
    net, batch = GCN(1).to(device), graph_batch(street, FRAMES, device)
    layers = nn.ModuleList(nn.Linear(*sizes) for sizes in zip((NODE_FEATURES, *WIDTHS), WIDTHS, strict=False))
    layers.to(device)
    return compare(
        ms(lambda: _both_ways(net.pooled(batch)), FRAMES),
        ms(lambda: _both_ways(_through([(layer, ()) for layer in layers], batch)), FRAMES),
        "ms a frame",
        f"{street.points:,} points: GCN / its linear layers alone, forward + backward",
    )


def graph_batch(street: Street, frames: int, device: str) -> batches.GraphBatch:
    """Return the first `frames` frames, ready for a network."""
    batch: Any = batches.from_arrays(street.arrays(frames)).to(device)
    return batch


def edge_index(batch: batches.GraphBatch) -> Tensor:
    """Return a batch's graph as PyTorch Geometric has it: int64 [2,E]."""
    node = torch.arange(len(batch.xyz), device=batch.xyz.device)
    return torch.stack([node.repeat_interleave(batch.degree.long()), batch.indices.long()])


def pyg_like(net: GCN) -> nn.ModuleList:
    """Return PyTorch Geometric's layers with the weights of ours."""
    from torch_geometric.nn import GCNConv

    layers = nn.ModuleList()
    for ours in cast(list[GCNLayer], net.layers):
        theirs = GCNConv(*ours.weight.shape, normalize=False)
        theirs.lin.weight.data = copy.deepcopy(ours.weight.data.T)
        theirs.bias.data = copy.deepcopy(ours.bias.data)
        layers.append(theirs)
    return layers.to(net.read_out.weight.device)


def _vs_pyg(street: Street, device: str, name: str, as_asked: Callable[..., tuple[Tensor, ...]]) -> Row:
    from torch_geometric.nn.conv.gcn_conv import gcn_norm

    net, batch = GCN(1).to(device), graph_batch(street, FRAMES, device)
    layers, index, nodes = pyg_like(net), edge_index(batch), len(batch.xyz)
    made = as_asked(*gcn_norm(index, None, nodes), nodes) if name == "CSR" else None

    def peer() -> None:
        graph = made or as_asked(*gcn_norm(index, None, nodes), nodes)
        _both_ways(_through([(layer, graph) for layer in layers], batch))

    return compare(
        ms(lambda: _both_ways(net.pooled(batch)), FRAMES),
        ms(peer, FRAMES),
        "ms a frame",
        f"{street.points:,} points: GCN / PyG GCNConv on {name}, forward + backward",
    )


def _through(layers: list[tuple[nn.Module, tuple[Tensor, ...]]], batch: batches.GraphBatch) -> Tensor:
    x = node_features(batch.xyz, batch.cls, 0.0)
    for layer, graph in layers:
        x = layer(x, *graph).relu()
    return mean_max_pool(x, batch.ptr)


def _both_ways(pooled: Tensor) -> None:
    pooled.square().sum().backward()  # type: ignore[no-untyped-call]
