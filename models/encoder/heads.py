"""Heads that any backbone with one feature map can take: metric depth and Cityscapes classes."""

import math

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from models.encoder.backbones import Part
from pipeline.camera import classes

MIN_DEPTH_M, MAX_DEPTH_M = 0.5, 120.0


class Pointwise(nn.Conv2d):
    """A 1x1 convolution as the matrix product that it is, on channels that lie together (channels last).

    On one thread torch's own copies its input and its gradient to other layouts and back.
    """

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__(inputs, outputs, 1)

    def forward(self, x: Tensor) -> Tensor:
        """Return [B,outputs,H,W] of [B,inputs,H,W]."""
        return F.linear(x.permute(0, 2, 3, 1), self.weight.flatten(1), self.bias).permute(0, 3, 1, 2)


class CellDepth(Part):
    """Depth of all pixels of a feature's cell at once (sub-pixel convolution).

    Edges stay sharp, where an interpolated depth would put points into the void behind each car.
    """

    def __init__(self, channels: int, stride: int) -> None:
        super().__init__()
        self.layers = nn.Sequential(Pointwise(channels, channels), nn.ReLU(), Pointwise(channels, stride**2))
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
        """Return logits [B,19,H,W], a pixel's together, from features [B,channels,ceil(H/stride),ceil(W/stride)]."""
        # In its weights each class has its pixels together. Turned round here, where it costs nothing, a pixel's
        # numbers are never torn apart: not by the shuffle, not by the softmax, and not by their gradients.
        weight, bias = (
            x.reshape(classes.COUNT, self.stride**2, -1).transpose(0, 1).flatten(0, 1) for x in self.layer.parameters()
        )
        cells = F.linear(features.permute(0, 2, 3, 1), weight, bias[:, 0])  # [B,h,w,stride·stride·19]
        batch, height, width, _ = cells.shape
        pixels = cells.view(batch, height, width, self.stride, self.stride, classes.COUNT).transpose(2, 3)
        logits = pixels.reshape(batch, height * self.stride, width * self.stride, classes.COUNT).permute(0, 3, 1, 2)
        return logits[..., : rays.shape[-2], : rays.shape[-1]]


def full(cells: Tensor, stride: int, rays: Tensor) -> Tensor:
    """Spread cells [B,C·stride²,h,w] over their pixels, [B,C,H,W]; the last cells may reach over the image."""
    return F.pixel_shuffle(cells, stride)[..., : rays.shape[-2], : rays.shape[-1]]


def bounded_depth(x: Tensor) -> Tensor:
    """Return metres, 0.5 to 120, for any number.

    A sigmoid over the logarithm: relative errors weigh the same near and far, and no value leaves the range.
    """
    share = torch.sigmoid(x.float())  # a half of 4.8, the logarithm of 120 m, is right to 1.6 % of a distance only
    return torch.exp(math.log(MIN_DEPTH_M) + math.log(MAX_DEPTH_M / MIN_DEPTH_M) * share)
