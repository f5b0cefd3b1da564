"""Graph convolution on a symmetric graph (paper eq. 3; Kipf and Welling 2017)."""

import torch
from torch import Tensor, nn

from models.steering.core.adjacency import normalised_adjacency, propagate
from models.steering.core.batch import GraphBatch
from models.steering.core.convolutions import Convolutions
from models.steering.core.graph_network import GraphNetwork, GraphOptions
from models.steering.core.options import Sizes


class GCNLayer(nn.Module):
    """H ↦ D̃^(-1/2) Ã D̃^(-1/2) H W + b with Ã = A + I: [N, ..., inputs] → [N, ..., outputs]. The caller adds σ."""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.weight = nn.Parameter(torch.empty(inputs, outputs))
        self.bias = nn.Parameter(torch.zeros(outputs))
        nn.init.xavier_uniform_(self.weight)

    @staticmethod
    def operator(batch: GraphBatch, dtype: torch.dtype) -> Tensor:
        """Return the normalised adjacency matrix, sparse [N,N], for all layers."""
        return normalised_adjacency(batch.degree, batch.indices, dtype)

    def forward(self, x: Tensor, adjacency: Tensor) -> Tensor:
        inputs, outputs = self.weight.shape
        if inputs <= outputs:  # the sparse product runs on the narrower side
            return nn.functional.linear(propagate(adjacency, x.flatten(1)).view_as(x), self.weight.T, self.bias)
        x = x @ self.weight
        return propagate(adjacency, x.flatten(1)).view_as(x) + self.bias


class GCN(GraphNetwork):
    """Graph convolution network, tile by tile on a CPU (core/convolutions.py).

    With sectors, on a GPU and in mixed precision it runs layer by layer, as the other networks on graphs.
    """

    def __init__(self, features: int, options: GraphOptions) -> None:
        super().__init__(GCNLayer, features, options)

    def pooled(self, batch: GraphBatch, versions: int) -> Tensor:
        kind = batch.xyz.device.type
        if self.sectors or kind != "cpu" or torch.is_autocast_enabled(kind):
            return super().pooled(batch, versions)
        weight, bias, *later = self.layers.parameters()
        # Mirroring changes the sign of node features; in Â H W that equals changing the sign of rows of W.
        wide = torch.cat([weight * signs[:, None] for signs in self.signs[:versions]], dim=1)
        pooled: Tensor = Convolutions.apply(batch, self.semantics, wide, bias.repeat(versions), *later)  # type: ignore[no-untyped-call]
        return pooled.view(len(pooled), 2, versions, -1).transpose(1, 2).flatten(2)


class Options(GraphOptions):
    """Options of GraphNetwork."""

    def build(self, sizes: Sizes) -> nn.Module:
        return GCN(sizes.features, self)
