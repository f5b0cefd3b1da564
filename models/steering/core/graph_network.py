"""Spatial network on point graphs: node features → graph layers → pooling → read-out."""

from typing import Annotated, ClassVar

import torch
from pydantic import AfterValidator, Field
from torch import Tensor, nn

from models.steering.core.batch import AnyGraph, FrameKind
from models.steering.core.features import NODE_FEATURES, mean_max_pool, node_features, sector_max_pool
from models.steering.core.options import Fraction, NetworkOptions, Widths


def _zero_or_odd(sectors: int) -> int:
    if sectors and not sectors % 2:
        raise ValueError("expected 0 or an odd number, whose middle sector is straight ahead")
    return sectors


class GraphOptions(NetworkOptions):
    """Options of the networks on graphs."""

    kind: ClassVar[FrameKind] = "graph"
    layers: Widths = (32, 32, 64)
    semantics: Fraction = 0.0  # λ of paper eq. 7, weight of the classes; 0: geometry alone
    sectors: Annotated[int, Field(ge=0, le=63), AfterValidator(_zero_or_odd)] = (
        0  # sectors of bearing with a maximum of their own
    )


class GraphNetwork(nn.Module):
    """Spatial network with one type of graph layer.

    Args:
        layer: class with `layer(inputs, outputs)`, a static `operator(batch, dtype)`, computed once per batch for all
            layers, and `forward(x [N, inputs], operator) -> [N, outputs]`.
        features: F, numbers per frame for the recurrent network.
    """

    def __init__(self, layer: type[nn.Module], features: int, options: GraphOptions = GraphOptions()) -> None:
        super().__init__()
        self.semantics, self.sectors, widths = options.semantics, options.sectors, options.layers
        self.layers = nn.ModuleList(
            layer(inputs, outputs) for inputs, outputs in zip([NODE_FEATURES, *widths[:-1]], widths, strict=True)
        )
        self.read_out = nn.Linear((2 + self.sectors) * widths[-1], features)

    def forward(self, batch: AnyGraph) -> Tensor:
        """Return [B,F]. Independent of the order of points and of the other frames in the batch."""
        return self.project(self.pooled(batch))

    def pooled(self, batch: AnyGraph) -> Tensor:
        """Return mean ‖ max over each frame's points after the last layer, ‖ max over each sector's: [B, pooled]."""
        dtype = self.read_out.weight.dtype
        operator = self.layers[0].operator(batch, dtype)  # type: ignore[operator]
        x = node_features(batch.xyz.to(dtype), batch.cls, self.semantics)  # [N, 25]
        for layer in self.layers:
            x = layer(x, operator).relu()  # [N, width]
        pooled = mean_max_pool(x, batch.ptr)
        return (
            torch.cat([pooled, sector_max_pool(x, batch.xyz, batch.ptr, self.sectors)], 1) if self.sectors else pooled
        )

    def project(self, pooled: Tensor) -> Tensor:
        """Map pooled values to features in (-1,1), where LTC synapses are sensitive: [..., pooled] → [..., F]."""
        return torch.tanh(self.read_out(pooled))
