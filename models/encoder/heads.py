"""Heads of encoders for metric depth and Cityscapes classes, and functions that they share."""

import math
from collections.abc import Sequence

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from pipeline.camera import classes

# Smallest depth that a head predicts, in metres.
MIN_DEPTH_M = 0.5
# Largest depth that a head predicts, in metres.
MAX_DEPTH_M = 120.0


def resize_map(x: Tensor, size: Sequence[int]) -> Tensor:
    """Interpolate a map [B,C,h,w] to `size` (H, W), in float32.

    The borders of both maps coincide. If the map shrinks, its pixels are averaged.
    """
    if x.shape[-2:] == torch.Size(size):
        return x
    return F.interpolate(
        x.float(), tuple(size), mode="bilinear", align_corners=False, antialias=True
    )


def scaled_by_focal(depth: Tensor, K: Tensor, trained: float) -> Tensor:
    """Scale the depth [B,H,W] that a network predicts to a camera with intrinsics K [B,3,3].

    `trained` is the focal length of the network's training images, divided by their width. A longer
    focal length makes objects look nearer.
    """
    focal_by_width = K[:, 0, 0] / depth.shape[-1]
    factor = (focal_by_width / trained).to(depth.dtype)
    return depth * factor[:, None, None]


def ray_slopes(K: Tensor, size: torch.Size) -> Tensor:
    """Return x/z and y/z of each pixel's ray, [B,2,H,W], for intrinsics [B,3,3] without skew."""
    height, width = size
    focal_x, _, centre_x = K[:, 0].unbind(1)
    _, focal_y, centre_y = K[:, 1].unbind(1)
    u = torch.arange(width, dtype=K.dtype, device=K.device)
    v = torch.arange(height, dtype=K.dtype, device=K.device)
    x = (u - centre_x[:, None]) / focal_x[:, None]  # [B,W]
    y = (v - centre_y[:, None]) / focal_y[:, None]  # [B,H]
    x = x[:, None].expand(-1, height, -1)
    y = y[:, :, None].expand(-1, -1, width)
    return torch.stack([x, y], dim=1).float()


class Pointwise(nn.Conv2d):
    """A 1x1 convolution, computed as a matrix product on images in channels-last order.

    On a single thread, torch's own convolution copies them to another order and back.
    """

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__(inputs, outputs, 1)

    def forward(self, x: Tensor) -> Tensor:
        pixels = F.linear(x.permute(0, 2, 3, 1), self.weight.flatten(1), self.bias)
        return pixels.permute(0, 3, 1, 2)


class CellDepth(nn.Module):
    """Depth of each pixel by sub-pixel convolution.

    A feature covers a cell of stride × stride pixels, and predicts the depth of each of them. An
    interpolation between features would blur the edges of objects.
    """

    def __init__(self, channels: int, stride: int) -> None:
        super().__init__()
        self.layers = nn.Sequential(
            Pointwise(channels, channels), nn.ReLU(), Pointwise(channels, stride**2)
        )
        self.stride = stride

    def forward(self, features: Tensor, rays: Tensor) -> Tensor:
        """Return depth [B,H,W] from features [B,channels,ceil(H/stride),ceil(W/stride)]."""
        height, width = rays.shape[-2:]
        cells = F.pixel_shuffle(self.layers(features), self.stride)[:, 0]
        pixels = cells[..., :height, :width]  # cells at the edges are cropped
        # The network predicts the logarithm of depth, so that relative errors count equally near
        # and far. It is float32, since half precision at log(120 m) is an error of 1.6 % of depth.
        share = torch.sigmoid(pixels.float())
        return torch.exp(math.log(MIN_DEPTH_M) + math.log(MAX_DEPTH_M / MIN_DEPTH_M) * share)


class CellClasses(nn.Module):
    """Class logits of each pixel by sub-pixel convolution, as in :class:`CellDepth`."""

    def __init__(self, channels: int, stride: int) -> None:
        super().__init__()
        self.layer = nn.Conv2d(channels, stride**2 * classes.COUNT, 1)
        self.stride = stride

    def forward(self, features: Tensor, rays: Tensor) -> Tensor:
        """Return logits [B,19,H,W] from features [B,channels,ceil(H/stride),ceil(W/stride)]."""
        # The weights are ordered by class, then by pixel. Here they are reordered by pixel, so that
        # the logits of a pixel are adjacent in memory. Then shuffle, softmax and their gradients
        # need no copies.
        weight, bias = self.layer.parameters()
        weight_by_pixel = self._by_pixel(weight)
        bias_by_pixel = self._by_pixel(bias)[:, 0]
        cells = F.linear(features.permute(0, 2, 3, 1), weight_by_pixel, bias_by_pixel)

        # Split the cells [B,h,w,stride·stride·19] into pixels, and crop those beyond the edges.
        stride = self.stride
        batch, h, w, _ = cells.shape
        pixels = cells.view(batch, h, w, stride, stride, classes.COUNT).transpose(2, 3)
        logits = pixels.reshape(batch, h * stride, w * stride, classes.COUNT).permute(0, 3, 1, 2)
        height, width = rays.shape[-2:]
        return logits[..., :height, :width]

    def _by_pixel(self, parameter: Tensor) -> Tensor:
        """Return a parameter of the layer ordered by pixel, then class, [stride·stride·19, …]."""
        by_class = parameter.reshape(classes.COUNT, self.stride**2, -1)
        return by_class.transpose(0, 1).flatten(0, 1)
