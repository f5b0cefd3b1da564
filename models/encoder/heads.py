"""Heads for backbones with one feature map: metric depth and Cityscapes classes."""

import math

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from models.encoder.backbones import Part
from pipeline.camera import classes

MIN_DEPTH_M, MAX_DEPTH_M = 0.5, 120.0


class Pointwise(nn.Conv2d):
    """A 1x1 convolution as a matrix product on channels last.

    On one thread, torch's own convolution copies input and gradient to another memory layout and back.
    """

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__(inputs, outputs, 1)

    def forward(self, x: Tensor) -> Tensor:
        """Map [B,inputs,H,W] to [B,outputs,H,W]."""
        return F.linear(x.permute(0, 2, 3, 1), self.weight.flatten(1), self.bias).permute(0, 3, 1, 2)


class CellDepth(Part):
    """Depth of all pixels of a feature's cell (sub-pixel convolution).

    Interpolated depth would put points between a car and its background; here edges stay sharp.
    """

    def __init__(self, channels: int, stride: int) -> None:
        super().__init__()
        self.layers = nn.Sequential(Pointwise(channels, channels), nn.ReLU(), Pointwise(channels, stride**2))
        self.stride = stride

    def forward(self, features: Tensor, rays: Tensor) -> Tensor:
        """Return depth [B,H,W] from features [B,channels,ceil(H/stride),ceil(W/stride)]."""
        return bounded_depth(full(self.layers(features), self.stride, rays)[:, 0])


class CellClasses(Part):
    """Class logits of all pixels of a feature's cell (sub-pixel convolution)."""

    def __init__(self, channels: int, stride: int) -> None:
        super().__init__()
        self.layer = nn.Conv2d(channels, stride**2 * classes.COUNT, 1)
        self.stride = stride

    def forward(self, features: Tensor, rays: Tensor) -> Tensor:
        """Return logits [B,19,H,W] from features [B,channels,ceil(H/stride),ceil(W/stride)]."""
        # The weights are ordered by class, then pixel. Reordered by pixel, the logits of a pixel stay adjacent in
        # memory through shuffle, softmax and their gradients, without copies.
        weight, bias = (
            x.reshape(classes.COUNT, self.stride**2, -1).transpose(0, 1).flatten(0, 1) for x in self.layer.parameters()
        )
        cells = F.linear(features.permute(0, 2, 3, 1), weight, bias[:, 0])  # [B,h,w,stride·stride·19]
        batch, height, width, _ = cells.shape
        pixels = cells.view(batch, height, width, self.stride, self.stride, classes.COUNT).transpose(2, 3)
        logits = pixels.reshape(batch, height * self.stride, width * self.stride, classes.COUNT).permute(0, 3, 1, 2)
        return logits[..., : rays.shape[-2], : rays.shape[-1]]


def full(cells: Tensor, stride: int, rays: Tensor) -> Tensor:
    """Spread cells [B,C·stride²,h,w] over their pixels, [B,C,H,W]; cells at the edges are cropped."""
    return F.pixel_shuffle(cells, stride)[..., : rays.shape[-2], : rays.shape[-1]]


def bounded_depth(x: Tensor) -> Tensor:
    """Map any number to 0.5 to 120 m, by a sigmoid over the logarithm: relative errors count equally near and far."""
    share = torch.sigmoid(x.float())  # half precision at log(120 m) has an error of 1.6 % of the depth
    return torch.exp(math.log(MIN_DEPTH_M) + math.log(MAX_DEPTH_M / MIN_DEPTH_M) * share)
