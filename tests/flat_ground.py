"""An encoder that predicts flat ground, houses 30 m away, and no classes."""

from pathlib import Path

import pytest
import torch
from torch import Tensor, nn

from models.encoder.heads import ray_slopes
from models.encoder.unified_encoder import BUILD
from pipeline.camera import classes
from pipeline.camera.geometry import CAMERA_HEIGHT_M
from pipeline.encoder.encoder_file import save_encoder


class FlatGround(nn.Module):
    def __init__(self) -> None:
        super().__init__()
        # the encoder's runner needs one to find the device
        self.unused = nn.Parameter(torch.zeros(1))

    def forward(self, image: Tensor, K: Tensor) -> tuple[Tensor, Tensor]:
        rays = ray_slopes(K, image.shape[-2:])
        logits = torch.zeros(len(image), classes.COUNT + 1, *image.shape[-2:])
        logits[:, -1] = 1
        return (CAMERA_HEIGHT_M / rays[:, 1].clamp(min=1e-3)).clamp(max=30), logits


def write_encoder(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Write the encoder to a folder and return it."""
    monkeypatch.setitem(BUILD, "flat ground", lambda architecture: FlatGround())
    save_encoder(folder, {"backbone": "flat ground"}, FlatGround().state_dict())
    return folder
