"""The spatial and the recurrent part of a trained network as modules on plain tensors, which exporters can trace.

The networks multiply by sparse matrices or sort nodes by degree, for which exporters lack operators. Here each node has
a padded list of neighbours, and masked sums replace both. Their order is fixed; scatter operators have none.
"""

import torch
from torch import Tensor, nn

from models.steering.core.batch import Batch, GraphBatch, ImageBatch, Level, SetBatch
from models.steering.core.features import node_features
from models.steering.core.graph_network import GraphNetwork
from models.steering.core.steering_net import SteeringNet
from models.steering.spatial.edgeconv import EdgeConvLayer
from models.steering.spatial.gatv2 import SLOPE, GATv2Layer
from models.steering.spatial.gnn import GCNLayer
from models.steering.spatial.pointnet2 import OFFSET_M, PointNet2


class Recurrent(nn.Module):
    """features [1,T,F], dt_s [1,T], of networks with motion also motion [1,T,4] → output [1]."""

    windows: Tensor

    def __init__(self, net: SteeringNet, window: int) -> None:
        super().__init__()
        # Without the spatial part, which would become part of the file.
        self.net = SteeringNet(nn.Identity(), net.temporal, net.equivariant, net.motion)
        self.register_buffer("windows", torch.arange(window)[None])

    def forward(self, *arrays: Tensor) -> Tensor:
        features, dt_s, *motion = arrays
        return self.net.recall(features[0], self.windows, dt_s, *(each[0] for each in motion))


class Spatial(nn.Module):
    """One frame → features [1,F].

    Inputs: an image; or xyz [N,3], cls [N], and for graphs degree [N] and neighbours [N,D], of which the first `degree`
    count; for sets centres [M] and neighbours [M,n] of each level.
    """

    def __init__(self, net: SteeringNet, kind: str) -> None:
        super().__init__()
        self.network, self.equivariant, self.kind = net.spatial, net.equivariant, kind

    def forward(self, *arrays: Tensor) -> Tensor:
        frame = self._batch(*arrays)
        features = _features(self.network, frame)
        return features - _features(self.network, frame.mirrored()) if self.equivariant else features

    def _batch(self, first: Tensor, *others: Tensor) -> Batch:
        if self.kind == "image":
            return ImageBatch(first)
        cls, *arrays = others
        if self.kind == "graph":
            return GraphBatch(first, cls, _pointer(first), *arrays)
        pairs = zip(arrays[::2], arrays[1::2], strict=True)
        levels = tuple(Level(centres, neighbours, _pointer(centres)) for centres, neighbours in pairs)
        return SetBatch(first, cls, _pointer(first), levels)


def _pointer(rows: Tensor) -> Tensor:
    """Return the row range of the single frame, int64 [2]."""
    return torch.cat([torch.zeros(1, dtype=torch.int64), torch.full((1,), rows.shape[0], dtype=torch.int64)])


def _features(network: nn.Module, frame: Batch) -> Tensor:
    """Return the features [1,F] of a frame; networks other than these run as they are."""
    if isinstance(network, GraphNetwork) and isinstance(frame, GraphBatch):
        valid = torch.arange(frame.indices.shape[1]) < frame.degree[:, None]  # [N,D]
        x = node_features(frame.xyz.to(network.read_out.weight.dtype), frame.cls, network.semantics)
        for layer in network.layers:
            x = _convolve(layer, x, frame.indices, valid).relu()
        return torch.tanh(network.read_out(torch.cat([x.mean(0), x.amax(0)])[None]))
    if isinstance(network, PointNet2) and isinstance(frame, SetBatch):
        xyz = frame.xyz.to(network.read_out.weight.dtype)
        x = node_features(xyz, frame.cls, network.semantics)
        for layer, level in zip(network.levels, frame.levels, strict=True):
            x = layer(xyz, x, level.centres, level.neighbours)
            xyz = xyz[level.centres]
        x = network.whole(torch.cat([xyz / OFFSET_M, x], dim=1)).amax(0)
        return torch.tanh(network.read_out(network.head(x[None])))
    features: Tensor = network(frame)
    return features


def _convolve(layer: nn.Module, x: Tensor, neighbours: Tensor, valid: Tensor) -> Tensor:
    """Return the output [N,outputs] of a graph layer for nodes x [N,inputs]; neighbours int64 and valid bool [N,D]."""
    if isinstance(layer, GCNLayer):
        scale = (valid.sum(1).to(x.dtype) + 1).rsqrt()[:, None]
        inputs, outputs = layer.weight.shape
        x = scale * (x if inputs <= outputs else x @ layer.weight)  # on the narrower side, as in the layer
        x = scale * (x + (x[neighbours] * valid[..., None]).sum(1))
        return (x @ layer.weight if inputs <= outputs else x) + layer.bias
    if isinstance(layer, EdgeConvLayer):
        weight_own, weight_difference = layer.linear.weight.chunk(2, dim=1)
        own = nn.functional.linear(x, weight_own - weight_difference, layer.linear.bias)
        difference = nn.functional.linear(x, weight_difference)
        largest = difference[neighbours].masked_fill(~valid[..., None], -torch.inf).amax(1)
        return torch.where(valid.any(1, keepdim=True), own + largest, 0.0)
    if isinstance(layer, GATv2Layer):
        heads = layer.attention.shape  # (heads, outputs / heads)
        left, right = layer.left(x), layer.right(x).view(-1, 1, *heads)
        senders = torch.cat([left[:, None], left[neighbours]], dim=1).view(x.shape[0], -1, *heads)  # [N,1+D,heads,C]
        scores = (nn.functional.leaky_relu(senders + right, SLOPE) * layer.attention).sum(3)
        valid = nn.functional.pad(valid, (1, 0), value=True)
        alpha = scores.masked_fill(~valid[..., None], -torch.inf).softmax(1)
        return (alpha[..., None] * senders).sum(1).flatten(1) + layer.bias
    raise ValueError(f"layer {type(layer).__name__} has no form for export: add it to {__name__}")
