"""A network without input: the ablation that measures the contribution of the scene."""

import torch
from torch import Tensor, nn

from models.steering.core.batch import GraphBatch
from models.steering.core.options import NetworkOptions, Sizes


class Blind(nn.Module):
    """Zeros for each frame: the recurrent network predicts from the car's motion alone."""

    def __init__(self, features: int) -> None:
        super().__init__()
        self.features = features

    def forward(self, batch: GraphBatch) -> Tensor:
        return torch.zeros(batch.frames, self.features, device=batch.xyz.device)


class Options(NetworkOptions):
    kind = "graph"
    sees_frames = False

    def build(self, sizes: Sizes) -> nn.Module:
        return Blind(sizes.features)
