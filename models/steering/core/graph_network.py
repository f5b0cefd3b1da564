"""Spatial network on point graphs: node features → graph layers → pooling → read-out."""

from typing import Annotated, ClassVar

import torch
from pydantic import AfterValidator, Field
from torch import Tensor, nn

from models.steering.core.batch import FrameKind, GraphBatch
from models.steering.core.features import (
    FEATURE_MIRROR_SIGNS,
    NODE_FEATURES,
    mean_max_pool,
    node_features,
    sector_max_pool,
)
from models.steering.core.options import NetworkOptions, Semantics, Widths


def _zero_or_odd(sectors: int) -> int:
    if sectors and not sectors % 2:
        raise ValueError("expected 0 or an odd number, whose middle sector is straight ahead")
    return sectors


class GraphOptions(NetworkOptions):
    """Options of the networks on graphs."""

    kind: ClassVar[FrameKind] = "graph"
    layers: Widths = (32, 32, 64)
    semantics: Semantics
    # Sectors of bearing with a maximum of their own.
    sectors: Annotated[int, Field(ge=0, le=63), AfterValidator(_zero_or_odd)] = 0


class GraphNetwork(nn.Module):
    """Spatial network with one type of graph layer.

    Args:
        layer: class with `layer(inputs, outputs)`, a static `operator(batch, dtype)`, computed once per batch for all
            layers, and `forward(x [N, ..., inputs], operator) -> [N, ..., outputs]`.
        features: F, numbers per frame for the recurrent network.
    """

    signs: Tensor
    block = 0  # points per block of complete frames on a CPU; 0: the whole batch

    def __init__(self, layer: type[nn.Module], features: int, options: GraphOptions) -> None:
        super().__init__()
        self.semantics, self.sectors, widths = options.semantics, options.sectors, options.layers
        self.layers = nn.ModuleList(
            layer(inputs, outputs) for inputs, outputs in zip([NODE_FEATURES, *widths[:-1]], widths, strict=True)
        )
        self.read_out = nn.Linear((2 + self.sectors) * widths[-1], features)
        # A buffer: a tensor made of numbers would be a blocking copy to a GPU in each step.
        signs = torch.tensor([[1.0] * NODE_FEATURES, FEATURE_MIRROR_SIGNS])
        self.register_buffer("signs", signs, persistent=False)  # [2,25], of the frame and of its mirror image

    def forward(self, batch: GraphBatch) -> Tensor:
        """Return [B,F]. Independent of the order of points and of the other frames in the batch."""
        return self.both(batch, 1)[0]

    def both(self, batch: GraphBatch, versions: int = 2) -> tuple[Tensor, ...]:
        """Return `forward` of the frames and, as a second version, of their mirror images, each [B,F]."""
        pooled = []  # mean ‖ max over each frame's points, ‖ max over each sector's: [B, S, pooled]
        for block in batch.blocks(self.block) if self.block and batch.xyz.device.type == "cpu" else [batch]:
            x = self.convolved(block, versions)
            pooled.append(mean_max_pool(x, block.ptr))
            if self.sectors:
                by_sector = sector_max_pool(x.flatten(1), block.xyz, block.ptr, self.sectors)
                by_sector = by_sector.view(-1, self.sectors, *x.shape[1:])
                if versions == 2:  # mirroring reverses the sectors
                    by_sector = torch.stack([by_sector[:, :, 0], by_sector[:, :, 1].flip(1)], dim=2)
                pooled[-1] = torch.cat([pooled[-1], by_sector.transpose(1, 2).flatten(2)], dim=2)
        # In (-1,1), where LTC synapses are sensitive.
        return torch.tanh(self.read_out(torch.cat(pooled))).unbind(1)

    def convolved(self, batch: GraphBatch, versions: int) -> Tensor:
        """Return the output of the last layer [N, S, width].

        S `versions`, the frames and with 2 also their mirror images, share the graph: a node has S sets of channels.
        """
        dtype = self.read_out.weight.dtype
        operator = self.layers[0].operator(batch, dtype)  # type: ignore[operator]
        x = node_features(batch.xyz.to(dtype), batch.cls, self.semantics)[:, None]  # [N, 1, 25]
        x = x * self.signs if versions == 2 else x
        for layer in self.layers:
            x = layer(x, operator).relu()
        return x
