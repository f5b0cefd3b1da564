"""Graph attention on a cached graph: edge weights computed from both ends (GATv2; Brody et al. 2022)."""

import math

import torch
from torch import Tensor, nn

from models.steering.core.aggregate import Chunks, aggregate, neighbourhoods
from models.steering.core.batch import GraphBatch
from models.steering.core.graph_network import GraphNetwork, GraphOptions
from models.steering.core.options import Sizes

HEADS = 4
SLOPE = 0.2  # of LeakyReLU, as in the paper


class GATv2Layer(nn.Module):
    """x_i ↦ Σ_j α_ij W_l x_j + b, α_ij = softmax_j(aᵀ LeakyReLU(W_l x_j + W_r x_i)), [N, .., C] → [N, .., C'].

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
        return neighbourhoods(batch, loops=True)

    def forward(self, x: Tensor, graph: Chunks) -> Tensor:
        dtype = self.attention.dtype  # scores and softmax in full precision under autocast
        left, right = (linear(x).to(dtype) for linear in (self.left, self.right))
        attention = self.attention.repeat(x.shape[1:-1].numel(), 1)  # the same for each set of channels
        return aggregate(attend, graph, left.flatten(1), right.flatten(1), attention).view_as(left) + self.bias


def attend(rows: Tensor, centre: Tensor, attention: Tensor, valid: Tensor | None = None) -> Tensor:
    """Return the attention-weighted sum [n,C] of the `valid` neighbours' rows [n,d,C].

    centre: [n,C], the nodes' own values; attention: a [heads,C/heads].
    """
    n, d, _ = rows.shape
    values = rows.view(n, d, *attention.shape)  # [n,d,heads,C/heads]
    hidden = nn.functional.leaky_relu(values + centre.view(n, 1, *attention.shape), SLOPE)
    scores = (hidden * attention).sum(3)  # [n,d,heads]
    scores = scores if valid is None else scores.masked_fill(~valid[..., None], -torch.inf)
    alpha = scores.softmax(dim=1)
    return (alpha[..., None] * values).sum(1).flatten(1)


class Options(GraphOptions):
    """Options of GraphNetwork."""

    def build(self, sizes: Sizes) -> nn.Module:
        return GraphNetwork(GATv2Layer, sizes.features, self)
