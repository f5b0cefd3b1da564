"""Edge convolution on a cached graph (DGCNN; Wang et al. 2019)."""

import torch
from torch import Tensor, nn

from models.steering.core.aggregate import Chunks, aggregate, neighbourhoods
from models.steering.core.batch import GraphBatch
from models.steering.core.graph_network import GraphNetwork, GraphOptions
from models.steering.core.options import Sizes


class EdgeConvLayer(nn.Module):
    """x_i ↦ max over neighbours j of W (x_i ‖ x_j - x_i) + b: [N, ..., inputs] → [N, ..., outputs]. The caller adds σ.

    DGCNN applies ReLU to each edge, then takes the maximum; ReLU is monotone, so the order does not matter. The affine
    map splits, W = (W_i ‖ W_d), into max_j (W_d x_j) + (W_i - W_d) x_i + b: products per node, none per edge. Unlike
    DGCNN, which searches neighbours in feature space for each layer, all layers use the cached graph. A node without
    neighbours becomes 0, as in PyG.
    """

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.linear = nn.Linear(2 * inputs, outputs)

    @staticmethod
    def operator(batch: GraphBatch, dtype: torch.dtype) -> Chunks:
        """Return the neighbourhoods of a batch's graph, for all layers."""
        return neighbourhoods(batch, loops=False)

    def forward(self, x: Tensor, graph: Chunks) -> Tensor:
        centre_weight, difference_weight = self.linear.weight.chunk(2, dim=1)
        centre = nn.functional.linear(x, centre_weight - difference_weight, self.linear.bias)
        difference = nn.functional.linear(x, difference_weight)
        dtype = self.linear.weight.dtype  # under autocast the products are bfloat16, too coarse to add up gradients
        rows = (tensor.to(dtype).flatten(1) for tensor in (difference, centre))
        return aggregate(centre_plus_max, graph, *rows).view_as(centre)


def centre_plus_max(rows: Tensor, centre: Tensor, valid: Tensor | None = None) -> Tensor:
    """Return centre [n,C] + max over the `valid` neighbours' rows [n,d,C]; equal maxima share the gradient."""
    rows = rows if valid is None else rows.masked_fill(~valid[..., None], -torch.inf)
    return centre + rows.amax(dim=1)


class Options(GraphOptions):
    """Options of GraphNetwork."""

    def build(self, sizes: Sizes) -> nn.Module:
        return GraphNetwork(EdgeConvLayer, sizes.features, self)
