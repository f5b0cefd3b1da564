"""A network that sees nothing: what is left of a model without the scene, to tell what the scene is worth."""

import torch
from torch import Tensor, nn

from models.steering.core.batch import GraphBatch, Kind

INPUT: Kind = "graph"


class Blind(nn.Module):
    """Zeros, whatever is there: with `motion`, the recurrent network hears of the car's motion alone."""

    def __init__(self, features: int) -> None:
        super().__init__()
        self.features = features

    def forward(self, batch: GraphBatch) -> Tensor:
        """Return zeros [B, features]."""
        return torch.zeros(batch.frames, self.features, device=batch.xyz.device)


network = Blind
