"""An encoder that predicts flat ground, houses 30 m away, and no classes."""

from pathlib import Path

import pytest
import torch
from torch import Tensor, nn

from models.encoder.backbones import Backbone, Part, Parts
from models.encoder.unified_encoder import BACKBONES, UnifiedEncoder
from pipeline.camera import classes
from pipeline.camera.mount import CAMERA_HEIGHT_M
from pipeline.perception.perceive import save


class Features(Backbone):
    """Passes the image on. The encoder's runner needs a parameter to find the device."""

    mean, std = (0.0, 0.0, 0.0), (1.0, 1.0, 1.0)

    def __init__(self) -> None:
        super().__init__()
        self.unused = nn.Parameter(torch.zeros(1))

    def forward(self, image: Tensor, rays: Tensor) -> Tensor:
        return image


class FlatGround(Part):
    def __init__(self, down: int) -> None:
        """`down`: axis of the camera."""
        super().__init__()
        self._down = down

    def forward(self, features: Tensor, rays: Tensor) -> Tensor:
        return (CAMERA_HEIGHT_M / rays[:, self._down].clamp(min=1e-3)).clamp(max=30)


class Void(Part):
    def forward(self, features: Tensor, rays: Tensor) -> Tensor:
        logits = torch.zeros(len(rays), classes.COUNT + 1, *rays.shape[-2:])
        logits[:, -1] = 1
        return logits


def write_encoder(folder: Path, monkeypatch: pytest.MonkeyPatch, down: int = 1) -> Path:
    """Write the encoder to a folder and return it."""
    monkeypatch.setitem(BACKBONES, "flat ground", lambda: Parts(Features(), FlatGround(down), Void()))
    save(folder, "flat ground", UnifiedEncoder("flat ground").state_dict())
    return folder
