"""Heads of the unified encoder: metric depth, also as a correction of flat ground, and Cityscapes classes."""

import math

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from models.encoder.backbones import Part
from pipeline.camera import classes
from pipeline.camera.mount import CAMERA_HEIGHT_M

MIN_DEPTH_M, MAX_DEPTH_M = 0.5, 120.0
MAX_GROUND_M = 80.0  # beyond, a pixel covers many metres
WIDTH = 32
DROPPED = 0.2  # share of features dropped in training, against overfitting to one place
MAX_CORRECTION = 0.7  # of the logarithm: a factor of 0.5 to 2


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
        cells = F.pixel_shuffle(self.layers(features), self.stride)[:, 0]  # cells at the edges are cropped
        return bounded_depth(cells[..., : rays.shape[-2], : rays.shape[-1]])


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


def bounded_depth(x: Tensor) -> Tensor:
    """Map any number to 0.5 to 120 m, by a sigmoid over the logarithm: relative errors count equally near and far."""
    share = torch.sigmoid(x.float())  # half precision at log(120 m) has an error of 1.6 % of the depth
    return torch.exp(math.log(MIN_DEPTH_M) + math.log(MAX_DEPTH_M / MIN_DEPTH_M) * share)


class GroundDepth(nn.Module):
    """Depth of flat ground times the exponential of a bounded correction, which is 0 before the fit."""

    def __init__(self, channels: int, classes: int) -> None:
        """`channels` of the features and `classes` of the logits."""
        super().__init__()
        self.seen = nn.Sequential(nn.Dropout2d(DROPPED), nn.Conv2d(channels, WIDTH, 1))
        self.assumed = nn.Conv2d(classes + 2, WIDTH, 3, padding=1)
        last = nn.Conv2d(WIDTH, 4, 1, bias=False)
        nn.init.zeros_(last.weight)
        self.layers = nn.Sequential(nn.ReLU(), nn.Conv2d(WIDTH, WIDTH, 3, padding=2, dilation=2), nn.ReLU(), last)

    def forward(self, features: Tensor, logits: Tensor, rays: Tensor) -> Tensor:
        """Return depth [B,H,W] in metres.

        Args:
            features: [B,channels,h,w], h and w at least half of H and W, with padding at the right and bottom.
            logits: [B,classes,h,w], Cityscapes' 19 classes first.
            rays: slopes [B,2,H,W] of the pixels.
        """
        h, w = features.shape[-2:]
        height, width = rays.shape[-2:]
        rays = F.pad(rays, (0, 2 * w - width, 0, 2 * h - height), mode="replicate")  # [B,2,2h,2w]
        with torch.no_grad():
            enlarged = F.interpolate(logits, (2 * h, 2 * w), mode="bilinear", align_corners=True)
            flat = ground_plane_depth(enlarged.argmax(dim=1), rays[:, 1], CAMERA_HEIGHT_M)  # [B,2h,2w]
            assumed = torch.cat([torch.log(flat)[:, None] / 4, 3 * rays[:, 1:]], dim=1)  # about -1 to 1
        x = self.seen(features) + self.assumed(torch.cat([logits.softmax(dim=1), F.avg_pool2d(assumed, 2)], dim=1))
        correction = F.pixel_shuffle(self.layers(x), 2)[:, 0].float()  # [B,2h,2w]
        depth = (flat * torch.exp(MAX_CORRECTION * torch.tanh(correction))).clamp(MIN_DEPTH_M, MAX_DEPTH_M)
        return depth[..., :height, :width]


def ground_plane_depth(cls: Tensor, slope: Tensor, camera_height_m: float) -> Tensor:
    """Return the depth [B,H,W] in metres of flat ground and of objects on it, in the precision of `slope`.

    Ground has Z = f·h/(v - c_y). Other pixels, the sky included, have the depth of the next ground pixel below them, or
    of the bottom row.

    Args:
        cls: trainIds int64 [B,H,W].
        slope: y/z [B,H,W] of a level camera's pixels, the same along a row.
        camera_height_m: height of the camera over the ground.
    """
    plane = camera_height_m / slope.clamp(min=camera_height_m / MAX_DEPTH_M)  # [B,H,W]
    ground = torch.stack([cls == number for number in classes.GROUND]).any(0) & (plane < MAX_GROUND_M)
    height = cls.shape[-2]
    rows = torch.arange(height, device=cls.device)[:, None].expand_as(cls)
    nearest = torch.where(ground, rows, height - 1).flip(-2).cummin(dim=-2).values.flip(-2)
    return plane.gather(-2, nearest)
