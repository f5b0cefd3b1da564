"""Graph convolution on a symmetric graph (paper eq. 3; Kipf and Welling 2017)."""

from typing import Any

import torch
from torch import Tensor, nn

from models.steering.core.adjacency import normalised_adjacency, propagate
from models.steering.core.batch import GraphBatch
from models.steering.core.features import node_features
from models.steering.core.graph_network import GraphNetwork, GraphOptions
from models.steering.core.options import Sizes

BLOCK = 8192  # points per block on a CPU; with 64 channels and two versions 4 MB in float32, about a core's cache


class GCNLayer(nn.Module):
    """H ↦ D̃^(-1/2) Ã D̃^(-1/2) H W + b with Ã = A + I: [N, ..., inputs] → [N, ..., outputs]. The caller adds σ."""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.weight = nn.Parameter(torch.empty(inputs, outputs))
        self.bias = nn.Parameter(torch.zeros(outputs))
        nn.init.xavier_uniform_(self.weight)

    def forward(self, x: Tensor, adjacency: Tensor) -> Tensor:
        """`adjacency`: the normalised matrix D̃^(-1/2) Ã D̃^(-1/2), sparse [N,N]."""
        inputs, outputs = self.weight.shape
        if inputs <= outputs:  # the sparse product runs on the narrower side
            return nn.functional.linear(propagate(adjacency, x.flatten(1)).view_as(x), self.weight.T, self.bias)
        x = x @ self.weight
        return propagate(adjacency, x.flatten(1)).view_as(x) + self.bias


class GCN(GraphNetwork):
    """Graph convolution network; on a CPU block by block, so that temporaries stay in the cache."""

    def __init__(self, features: int, options: GraphOptions) -> None:
        super().__init__(GCNLayer, features, options)

    def pooled(self, batch: GraphBatch, versions: int) -> Tensor:
        blocks = batch.blocks(BLOCK) if batch.xyz.device.type == "cpu" else [batch]
        return torch.cat([GraphNetwork.pooled(self, block, versions) for block in blocks])

    def convolved(self, batch: GraphBatch, versions: int) -> Tensor:
        dtype = self.read_out.weight.dtype
        adjacency = normalised_adjacency(batch.degree, batch.indices, dtype)
        layers: Any = self.layers
        first, *later = layers
        # Versions share the first sparse product: the signs of node features are those of rows of the weight.
        x = propagate(adjacency, node_features(batch.xyz.to(dtype), batch.cls, self.semantics))  # [N, 25]
        weight = torch.cat([first.weight * signs[:, None] for signs in self.signs[:versions]], dim=1)
        x = torch.addmm(first.bias.repeat(versions), x, weight).relu().view(len(x), versions, first.bias.numel())
        for layer in later:
            x = layer(x, adjacency).relu()  # [N, S, width]
        return x


class Options(GraphOptions):
    """Options of GraphNetwork."""

    def build(self, sizes: Sizes) -> nn.Module:
        return GCN(sizes.features, self)
