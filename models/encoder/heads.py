"""Heads of encoders, metric depth and Cityscapes classes, and what several networks need."""

import math
from collections.abc import Sequence

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from pipeline.camera import classes

MIN_DEPTH_M, MAX_DEPTH_M = 0.5, 120.0


def resized(x: Tensor, size: Sequence[int]) -> Tensor:
    """Interpolate a map [B,C,h,w] to `size`, in float32, with averages where it shrinks; pixel
    centres stay aligned.
    """
    if x.shape[-2:] == torch.Size(size):
        return x
    return F.interpolate(
        x.float(), tuple(size), mode="bilinear", align_corners=False, antialias=True
    )


def scaled_by_focal(depth: Tensor, K: Tensor, trained: float) -> Tensor:
    """Scale depth [B,H,W] of a network that was trained with one camera to the camera with
    intrinsics K [B,3,3].

    `trained` is focal length / image width of its training images: a longer lens makes objects look
    nearer.
    """
    return depth * (K[:, 0, 0] / depth.shape[-1] / trained).to(depth.dtype)[:, None, None]


def ray_slopes(K: Tensor, size: torch.Size) -> Tensor:
    """Return x/z and y/z of each pixel's ray, [B,2,H,W], for intrinsics [B,3,3] without skew."""
    v = torch.arange(size[0], dtype=K.dtype, device=K.device).view(1, -1, 1)
    u = torch.arange(size[1], dtype=K.dtype, device=K.device).view(1, 1, -1)
    x = (u - K[:, 0, 2, None, None]) / K[:, 0, 0, None, None]  # [B,1,W]
    y = (v - K[:, 1, 2, None, None]) / K[:, 1, 1, None, None]  # [B,H,1]
    return torch.stack([x.expand(-1, size[0], -1), y.expand(-1, -1, size[1])], dim=1).float()


class Pointwise(nn.Conv2d):
    """A 1x1 convolution as a product on channels last. On one thread, torch's changes the layout
    and back.
    """

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__(inputs, outputs, 1)

    def forward(self, x: Tensor) -> Tensor:
        return F.linear(x.permute(0, 2, 3, 1), self.weight.flatten(1), self.bias).permute(
            0, 3, 1, 2
        )


class CellDepth(nn.Module):
    """Depth of all pixels of a feature's cell (sub-pixel convolution). Interpolation would blur
    edges of objects.
    """

    def __init__(self, channels: int, stride: int) -> None:
        super().__init__()
        self.layers = nn.Sequential(
            Pointwise(channels, channels), nn.ReLU(), Pointwise(channels, stride**2)
        )
        self.stride = stride

    def forward(self, features: Tensor, rays: Tensor) -> Tensor:
        """Return depth [B,H,W] from features [B,channels,ceil(H/stride),ceil(W/stride)]."""
        # cells at the edges are cropped
        cells = F.pixel_shuffle(self.layers(features), self.stride)[:, 0]
        # Over the logarithm: relative errors count equally near and far. Half precision at log(120
        # m) has an error of 1.6 % of the depth.
        share = torch.sigmoid(cells[..., : rays.shape[-2], : rays.shape[-1]].float())
        return torch.exp(math.log(MIN_DEPTH_M) + math.log(MAX_DEPTH_M / MIN_DEPTH_M) * share)


class CellClasses(nn.Module):
    """Class logits of all pixels of a feature's cell (sub-pixel convolution)."""

    def __init__(self, channels: int, stride: int) -> None:
        super().__init__()
        self.layer = nn.Conv2d(channels, stride**2 * classes.COUNT, 1)
        self.stride = stride

    def forward(self, features: Tensor, rays: Tensor) -> Tensor:
        """Return logits [B,19,H,W] from features [B,channels,ceil(H/stride),ceil(W/stride)]."""
        # The weights are ordered by class, then pixel. Reordered by pixel, the logits of a pixel
        # stay adjacent in memory through shuffle, softmax and their gradients, without copies.
        weight, bias = (
            x.reshape(classes.COUNT, self.stride**2, -1).transpose(0, 1).flatten(0, 1)
            for x in self.layer.parameters()
        )
        # [B,h,w,stride·stride·19]
        cells = F.linear(features.permute(0, 2, 3, 1), weight, bias[:, 0])
        batch, height, width, _ = cells.shape
        pixels = cells.view(
            batch, height, width, self.stride, self.stride, classes.COUNT
        ).transpose(2, 3)
        logits = pixels.reshape(
            batch, height * self.stride, width * self.stride, classes.COUNT
        ).permute(0, 3, 1, 2)
        return logits[..., : rays.shape[-2], : rays.shape[-1]]
