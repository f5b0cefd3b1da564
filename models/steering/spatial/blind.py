"""A network that ignores its frames.

It is the ablation that measures what the scene contributes.
"""

import torch
from torch import Tensor, nn

from models.steering.core.batch import GraphBatch
from models.steering.core.options import NetworkOptions, Sizes


class Blind(nn.Module):
    """Features of 0 for each frame, so that the recurrent network sees the car's motion alone."""

    def __init__(self, features: int) -> None:
        super().__init__()
        self.features = features

    def forward(self, batch: GraphBatch) -> Tensor:
        return torch.zeros(batch.frames, self.features, device=batch.xyz.device)


class Options(NetworkOptions):
    # Only the number of frames is read, but each network needs a kind.
    kind = "graph"
    sees_frames = False

    def build(self, sizes: Sizes) -> nn.Module:
        return Blind(sizes.features)
