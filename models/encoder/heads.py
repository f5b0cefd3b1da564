"""Heads that any backbone with one feature map can take: metric depth and Cityscapes classes."""

import math

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from models.encoder.backbones import Part
from pipeline.camera import classes

MIN_DEPTH_M, MAX_DEPTH_M = 0.5, 120.0


class CellDepth(Part):
    """Depth of all pixels of a feature's cell at once (sub-pixel convolution).

    Edges stay sharp, where an interpolated depth would put points into the void behind each car.
    """

    def __init__(self, channels: int, stride: int) -> None:
        super().__init__()
        self.layers = nn.Sequential(nn.Conv2d(channels, channels, 1), nn.ReLU(), nn.Conv2d(channels, stride**2, 1))
        self.stride = stride

    def forward(self, features: Tensor, rays: Tensor) -> Tensor:
        """Return depth [B,H,W] from features [B,channels,ceil(H/stride),ceil(W/stride)]."""
        return bounded_depth(full(self.layers(features), self.stride, rays)[:, 0])


class CellClasses(Part):
    """Class logits of all pixels of a feature's cell at once."""

    def __init__(self, channels: int, stride: int) -> None:
        super().__init__()
        self.layer = nn.Conv2d(channels, stride**2 * classes.COUNT, 1)
        self.stride = stride

    def forward(self, features: Tensor, rays: Tensor) -> Tensor:
        """Return logits [B,19,H,W] from features [B,channels,ceil(H/stride),ceil(W/stride)]."""
        return full(self.layer(features), self.stride, rays)


def full(cells: Tensor, stride: int, rays: Tensor) -> Tensor:
    """Spread cells [B,C·stride²,h,w] over their pixels, [B,C,H,W]; the last cells may reach over the image."""
    return F.pixel_shuffle(cells, stride)[..., : rays.shape[-2], : rays.shape[-1]]


def bounded_depth(x: Tensor) -> Tensor:
    """Return metres, 0.5 to 120, for any number.

    A sigmoid over the logarithm: relative errors weigh the same near and far, and no value leaves the range.
    """
    share = torch.sigmoid(x.float())  # a half of 4.8, the logarithm of 120 m, is right to 1.6 % of a distance only
    return torch.exp(math.log(MIN_DEPTH_M) + math.log(MAX_DEPTH_M / MIN_DEPTH_M) * share)
