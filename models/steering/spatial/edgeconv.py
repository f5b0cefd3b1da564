"""Edge convolution on a cached graph (DGCNN; Wang et al. 2019)."""

from functools import partial

import torch
from torch import Tensor, nn

from models.steering.core.aggregate import Chunks, aggregate, neighbourhoods
from models.steering.core.batch import GraphBatch, Kind
from models.steering.core.graph_network import GraphNetwork

INPUT: Kind = "graph"


class EdgeConvLayer(nn.Module):
    """x_i ↦ max over neighbours j of W (x_i ‖ x_j - x_i) + b: [N, inputs] → [N, outputs]. The caller adds σ.

    DGCNN applies ReLU to each edge, then takes the maximum; ReLU is monotone, so that after the maximum it is the
    same. The affine map splits, W = (W_i ‖ W_d), into max_j (W_d x_j) + (W_i - W_d) x_i + b: products per node, none
    per edge. DGCNN also finds new neighbours in feature space for each layer; here the cached graph serves all. A node
    without neighbours becomes 0, as in PyG.
    """

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.linear = nn.Linear(2 * inputs, outputs)

    @staticmethod
    def operator(batch: GraphBatch, dtype: torch.dtype) -> Chunks:
        """What a batch's graph gives to all layers."""
        return neighbourhoods(batch.degree, batch.indices, loops=False)

    def forward(self, x: Tensor, chunks: Chunks) -> Tensor:
        of_own, of_difference = self.linear.weight.chunk(2, dim=1)
        own = nn.functional.linear(x, of_own - of_difference, self.linear.bias)
        difference = nn.functional.linear(x, of_difference)
        dtype = self.linear.weight.dtype  # under autocast the products are halves; gradients must not add up in those
        return aggregate(own_plus_max, chunks, difference.to(dtype), own.to(dtype))


def own_plus_max(rows: Tensor, own: Tensor) -> Tensor:
    """Return own [n,C] + the maximum over the neighbours' rows [n,d,C]; equal maxima share the gradient."""
    return own + rows.amax(dim=1)


network = partial(GraphNetwork, EdgeConvLayer)
