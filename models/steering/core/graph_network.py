"""Spatial network on point graphs: node features → graph layers → pooling → read-out."""

from typing import ClassVar

import torch
from torch import Tensor, nn

from models.steering.core.batch import AnyGraph, FrameKind
from models.steering.core.features import NODE_FEATURES, mean_max_pool, node_features
from models.steering.core.options import Fraction, NetworkOptions, Widths


class GraphOptions(NetworkOptions):
    """Options of the networks on graphs."""

    kind: ClassVar[FrameKind] = "graph"
    layers: Widths = (32, 32, 64)
    semantics: Fraction = 0.0  # λ of paper eq. 7, weight of the classes; 0: geometry alone


class GraphNetwork(nn.Module):
    """Spatial network with one type of graph layer.

    Args:
        layer: class with `layer(inputs, outputs)`, a static `operator(batch, dtype)`, computed once per batch for all
            layers, and `forward(x [N, inputs], operator) -> [N, outputs]`.
        features: F, numbers per frame for the recurrent network.
    """

    def __init__(self, layer: type[nn.Module], features: int, options: GraphOptions = GraphOptions()) -> None:
        super().__init__()
        self.semantics, widths = options.semantics, options.layers
        self.layers = nn.ModuleList(
            layer(inputs, outputs) for inputs, outputs in zip([NODE_FEATURES, *widths[:-1]], widths, strict=True)
        )
        self.read_out = nn.Linear(2 * widths[-1], features)

    def forward(self, batch: AnyGraph) -> Tensor:
        """Return [B,F]. Independent of the order of points and of the other frames in the batch."""
        return self.project(self.pooled(batch))

    def pooled(self, batch: AnyGraph) -> Tensor:
        """Return mean ‖ max over each frame's points after the last layer: [B, 2 width]."""
        dtype = self.read_out.weight.dtype
        operator = self.layers[0].operator(batch, dtype)  # type: ignore[operator]
        x = node_features(batch.xyz.to(dtype), batch.cls, self.semantics)  # [N, 25]
        for layer in self.layers:
            x = layer(x, operator).relu()  # [N, width]
        return mean_max_pool(x, batch.ptr)

    def project(self, pooled: Tensor) -> Tensor:
        """Map pooled values to features in (-1,1), where LTC synapses are sensitive: [..., 2 width] → [..., F]."""
        return torch.tanh(self.read_out(pooled))
