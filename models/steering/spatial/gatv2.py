"""Graph attention on a cached graph: edge weights computed from both ends (GATv2; Brody et al. 2022)."""

import math

import torch
from torch import Tensor, nn

from models.steering.core.aggregate import Chunks, aggregate, neighbourhoods
from models.steering.core.batch import GraphBatch
from models.steering.core.graph_network import GraphKnobs, GraphNetwork
from models.steering.core.knobs import Sizes

HEADS = 4
SLOPE = 0.2  # of LeakyReLU, as in the paper


class GATv2Layer(nn.Module):
    """x_i ↦ Σ_j α_ij W_l x_j + b, α_ij = softmax_j(aᵀ LeakyReLU(W_l x_j + W_r x_i)): [N, inputs] → [N, outputs].

    j runs over i's neighbours and i itself. The outputs are split among 4 heads, or the greatest common divisor of 4
    and `outputs`; each has its own a. W_l and W_r have biases, as in PyG. The caller adds σ.
    """

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        heads = math.gcd(HEADS, outputs)
        self.left, self.right = nn.Linear(inputs, outputs), nn.Linear(inputs, outputs)  # W_l, W_r
        self.attention = nn.Parameter(torch.empty(heads, outputs // heads))
        self.bias = nn.Parameter(torch.zeros(outputs))
        for weight in (self.left.weight, self.right.weight, self.attention):
            nn.init.xavier_uniform_(weight)
        for linear in (self.left, self.right):
            nn.init.zeros_(linear.bias)

    @staticmethod
    def operator(batch: GraphBatch, dtype: torch.dtype) -> Chunks:
        """Return the neighbourhoods of a batch's graph, for all layers."""
        return neighbourhoods(batch.degree, batch.indices, loops=True)

    def forward(self, x: Tensor, chunks: Chunks) -> Tensor:
        dtype = self.attention.dtype  # scores and softmax in full precision under autocast
        return aggregate(attend, chunks, self.left(x).to(dtype), self.right(x).to(dtype), self.attention) + self.bias


def attend(rows: Tensor, own: Tensor, attention: Tensor) -> Tensor:
    """Return the attention-weighted sum [n,C]: neighbours' rows [n,d,C], nodes' own [n,C], a [heads,C/heads]."""
    n, d, _ = rows.shape
    values = rows.view(n, d, *attention.shape)  # [n,d,heads,C/heads]
    hidden = nn.functional.leaky_relu(values + own.view(n, 1, *attention.shape), SLOPE)
    alpha = (hidden * attention).sum(3).softmax(dim=1)  # [n,d,heads]
    return (alpha[..., None] * values).sum(1).flatten(1)


class Knobs(GraphKnobs):
    """Options of GraphNetwork."""

    def build(self, sizes: Sizes) -> nn.Module:
        return GraphNetwork(GATv2Layer, sizes.features, self)
