"""Graph attention on a cached graph: edges weighted by what their two ends have learned (GATv2; Brody et al. 2022)."""

import math
from functools import partial

import torch
from torch import Tensor, nn

from models.steering.core.aggregate import Chunks, aggregate, neighbourhoods
from models.steering.core.batch import GraphBatch, Kind
from models.steering.core.graph_network import GraphNetwork

INPUT: Kind = "graph"
HEADS = 4
SLOPE = 0.2  # of the leaky ReLU, as in the paper


class GATv2Layer(nn.Module):
    """x_i ↦ Σ_j α_ij W_l x_j + b, α_ij = softmax_j(aᵀ LeakyReLU(W_l x_j + W_r x_i)): [N, inputs] → [N, outputs].

    j runs over i's neighbours and i itself. Heads, each with its own a and share of the outputs, stand side by side:
    4, or the most of 4 that divide the outputs. W_l and W_r have biases, as in PyG. The caller adds σ.
    """

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        heads = math.gcd(HEADS, outputs)
        self.left, self.right = nn.Linear(inputs, outputs), nn.Linear(inputs, outputs)  # W_l of senders, W_r of i
        self.attention = nn.Parameter(torch.empty(heads, outputs // heads))
        self.bias = nn.Parameter(torch.zeros(outputs))
        for weight in (self.left.weight, self.right.weight, self.attention):
            nn.init.xavier_uniform_(weight)
        for linear in (self.left, self.right):
            nn.init.zeros_(linear.bias)

    @staticmethod
    def operator(batch: GraphBatch, dtype: torch.dtype) -> Chunks:
        """What a batch's graph gives to all layers."""
        return neighbourhoods(batch.degree, batch.indices, loops=True)

    def forward(self, x: Tensor, chunks: Chunks) -> Tensor:
        dtype = self.attention.dtype  # scores and softmax stay in full precision under autocast
        return aggregate(attend, chunks, self.left(x).to(dtype), self.right(x).to(dtype), self.attention) + self.bias


def attend(rows: Tensor, own: Tensor, attention: Tensor) -> Tensor:
    """Return [n,C], the senders' rows [n,d,C] weighted by attention [heads,C/heads] given the receivers' own [n,C]."""
    n, d, _ = rows.shape
    sent = rows.view(n, d, *attention.shape)  # [n,d,heads,C/heads]
    heard = nn.functional.leaky_relu(sent + own.view(n, 1, *attention.shape), SLOPE)
    alpha = (heard * attention).sum(3).softmax(dim=1)  # [n,d,heads]
    return (alpha[..., None] * sent).sum(1).flatten(1)


network = partial(GraphNetwork, GATv2Layer)
