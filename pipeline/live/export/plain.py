"""Trained networks on one frame, or one window, in operators that exporters know: gather, scatter, dense products.

The networks themselves take a graph as a sparse matrix, or sort its nodes by their number of neighbours: fast, but
torch.export knows neither. What is written here says the same of the same weights, with a row per edge.
"""

from functools import singledispatch

import torch
from torch import Tensor, nn

from models.steering.core.batch import Batch, GraphBatch, SetBatch
from models.steering.core.features import node_features
from models.steering.core.graph_network import GraphNetwork
from models.steering.core.steering_net import SteeringNet
from models.steering.spatial.edgeconv import EdgeConvLayer
from models.steering.spatial.gatv2 import SLOPE, GATv2Layer
from models.steering.spatial.gnn import GCNLayer
from models.steering.spatial.pointnet2 import OFFSET_M, PointNet2


class Recurrent(nn.Module):
    """What a window of features says: features [1,T,F], dt_s [1,T], with motion [1,T,4] → answer [1]."""

    windows: Tensor

    def __init__(self, net: SteeringNet, window: int) -> None:
        super().__init__()
        # Without the spatial part: what a module holds becomes part of its file.
        self.net = SteeringNet(nn.Identity(), net.temporal, net.equivariant, net.motion)
        self.register_buffer("windows", torch.arange(window)[None])

    def forward(self, features: Tensor, dt_s: Tensor, motion: Tensor | None = None) -> Tensor:
        return self.net.recall(features[0], self.windows, dt_s, None if motion is None else motion[0])


class Spatial(nn.Module):
    """What the spatial network sees in one frame: the batch's tensors but the pointers → features [1,F]."""

    def __init__(self, net: SteeringNet) -> None:
        super().__init__()
        self.network, self.equivariant = net.spatial, net.equivariant

    def of_frame(self, frame: Batch) -> Tensor:
        features = seen(self.network, frame)
        return features - seen(self.network, frame.mirrored()) if self.equivariant else features


@singledispatch
def seen(network: nn.Module, frame: Batch) -> Tensor:
    """Return what a spatial network says of a batch of one frame, [1,F]. Others than these are taken as they are."""
    features: Tensor = network(frame)
    return features


@seen.register
def _(network: GraphNetwork, frame: GraphBatch) -> Tensor:
    edges = Edges(frame.degree, frame.indices)
    x = node_features(frame.xyz.to(network.read_out.weight.dtype), frame.cls, network.semantics)
    for layer in network.layers:
        x = convolved(layer, x, edges).relu()
    return network.project(torch.cat([x.mean(0), x.amax(0)])[None])


@seen.register
def _(network: PointNet2, frame: SetBatch) -> Tensor:
    xyz = frame.xyz.to(network.read_out.weight.dtype)
    f = node_features(xyz, frame.cls, network.semantics)
    for layer, level in zip(network.levels, frame.levels, strict=True):
        f = layer(xyz, f, level.centres, level.neighbours)
        xyz = xyz[level.centres]
    h = network.whole(torch.cat([xyz / OFFSET_M, f], dim=1)).amax(0)
    return torch.tanh(network.read_out(network.head(h[None])))


class Edges:
    """A graph's E directed edges: `neighbour` j of `node` i, int64 [E] each; N nodes.

    Args:
        degree: [N], neighbours per node.
        indices: [E], neighbours of node 0, of node 1, …
    """

    def __init__(self, degree: Tensor, indices: Tensor) -> None:
        self.degree, self.neighbour = degree.long(), indices.long()
        edges = indices.shape[0]
        # An edge's node is the number of nodes whose edges begin at it or before, but one. ONNX has no
        # repeat_interleave. The last place is where those begin that come after all edges.
        starts = self.degree.cumsum(0) - self.degree
        begun = starts.new_zeros(edges + 1).index_add(0, starts, torch.ones_like(starts))
        self.node = begun.cumsum(0)[:edges] - 1

    def sums(self, rows: Tensor) -> Tensor:
        """Return the sum of the rows [E,C] of each node's edges, [N,C]."""
        return rows.new_zeros(self.degree.shape[0], rows.shape[1]).index_add(0, self.node, rows)

    def maxima(self, rows: Tensor) -> Tensor:
        """Return the maximum of the rows [E,C] of each node's edges, [N,C]; minus infinity of none."""
        least = rows.new_full((self.degree.shape[0], rows.shape[1]), -torch.inf)
        return least.scatter_reduce(0, self.node[:, None].expand_as(rows), rows, "amax")


@singledispatch
def convolved(layer: nn.Module, x: Tensor, edges: Edges) -> Tensor:
    """Return what a layer on graphs makes of nodes, [N, inputs] → [N, outputs]. Raises ValueError of unknown layers."""
    raise ValueError(f"{type(layer).__name__} has no plain form in pipeline/live/export/plain.py: add it there")


@convolved.register
def _(layer: GCNLayer, x: Tensor, edges: Edges) -> Tensor:
    scale = (edges.degree.to(x.dtype) + 1).rsqrt()[:, None]
    inputs, outputs = layer.weight.shape
    # As the layer does, on the narrower side.
    x = scale * (x if inputs <= outputs else x @ layer.weight)
    x = scale * (x + edges.sums(x[edges.neighbour]))
    return (x @ layer.weight if inputs <= outputs else x) + layer.bias


@convolved.register
def _(layer: EdgeConvLayer, x: Tensor, edges: Edges) -> Tensor:
    of_own, of_difference = layer.linear.weight.chunk(2, dim=1)
    own = nn.functional.linear(x, of_own - of_difference, layer.linear.bias)
    difference = nn.functional.linear(x, of_difference)
    return torch.where(edges.degree[:, None] > 0, own + edges.maxima(difference[edges.neighbour]), 0.0)


@convolved.register
def _(layer: GATv2Layer, x: Tensor, edges: Edges) -> Tensor:
    def scores(sent: Tensor, own: Tensor) -> Tensor:
        heard = nn.functional.leaky_relu(sent + own, SLOPE).view(-1, *layer.attention.shape)
        return (heard * layer.attention).sum(2)  # [..., heads]

    def spread(weight: Tensor) -> Tensor:
        return weight.repeat_interleave(layer.attention.shape[1], dim=1)  # a head's for each of its channels

    left, right = layer.left(x), layer.right(x)
    # A node listens to itself, too.
    to_own, to_others = scores(left, right), scores(left[edges.neighbour], right[edges.node])
    top = torch.maximum(to_own, edges.maxima(to_others))
    to_own, to_others = (to_own - top).exp(), (to_others - top[edges.node]).exp()
    heard = spread(to_own) * left + edges.sums(spread(to_others) * left[edges.neighbour])
    return heard / spread(to_own + edges.sums(to_others)) + layer.bias
