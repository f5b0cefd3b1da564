"""One shared backbone, two heads: metric depth and Cityscapes classes of an image in one forward pass (paper §3.2)."""

import math
from collections.abc import Callable

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from models.backbones import Backbone
from models.backbones.small import Small

BACKBONES: dict[str, Callable[[], Backbone]] = {"small": Small}

CLASSES = 19
MIN_DEPTH_M, MAX_DEPTH_M = 0.5, 120.0


class UnifiedEncoder(nn.Module):
    """Image and intrinsics → depth in metres and 19 class logits of each pixel.

    Both heads are 1x1 convolutions that predict all pixels of a feature's cell at once (sub-pixel convolution): edges
    stay sharp, where an interpolated depth would put points into the void behind each car.
    """

    def __init__(self, backbone: str) -> None:
        """`backbone` is a key of BACKBONES; raises ValueError, listing them, if it is none."""
        super().__init__()
        if backbone not in BACKBONES:
            raise ValueError(f"there is no backbone {backbone!r}: known: {', '.join(BACKBONES)}")
        self.backbone = BACKBONES[backbone]()
        cell = self.backbone.stride**2
        channels = self.backbone.channels
        self.depth_head = nn.Sequential(nn.Conv2d(channels, channels, 1), nn.ReLU(), nn.Conv2d(channels, cell, 1))
        self.class_head = nn.Conv2d(channels, cell * CLASSES, 1)

    def forward(self, image: Tensor, K: Tensor) -> tuple[Tensor, Tensor]:
        """Return depth [B,H,W] (metres along the optical axis, 0.5 to 120) and class logits [B,19,H,W].

        Args:
            image: RGB [B,3,H,W], uint8, or floats from 0 to 1.
            K: pinhole intrinsics [B,3,3] of images of this size.
        """
        size = image.shape[-2:]
        rgb = image.float() / 255 if image.dtype == torch.uint8 else image
        mean, std = rgb.new_tensor(self.backbone.mean), rgb.new_tensor(self.backbone.std)
        rgb = (rgb - mean[:, None, None]) / std[:, None, None]
        features = self.backbone(rgb, ray_slopes(K, size))  # [B,C,H/s,W/s]
        depth = self._full(self.depth_head(features), size)[:, 0]  # [B,H,W]
        logits = self._full(self.class_head(features), size)  # [B,19,H,W]
        # A sigmoid over the logarithm: relative errors weigh the same near and far, and no value leaves the range.
        log_depth = math.log(MIN_DEPTH_M) + math.log(MAX_DEPTH_M / MIN_DEPTH_M) * torch.sigmoid(depth)
        return torch.exp(log_depth), logits

    def _full(self, cells: Tensor, size: torch.Size) -> Tensor:
        return F.pixel_shuffle(cells, self.backbone.stride)[..., : size[0], : size[1]]


def ray_slopes(K: Tensor, size: torch.Size) -> Tensor:
    """Return x/z and y/z of each pixel's ray, [B,2,H,W], for intrinsics [B,3,3] without skew."""
    v = torch.arange(size[0], dtype=K.dtype, device=K.device).view(1, -1, 1)
    u = torch.arange(size[1], dtype=K.dtype, device=K.device).view(1, 1, -1)
    x = (u - K[:, 0, 2, None, None]) / K[:, 0, 0, None, None]  # [B,1,W]
    y = (v - K[:, 1, 2, None, None]) / K[:, 1, 1, None, None]  # [B,H,1]
    return torch.stack([x.expand(-1, size[0], -1), y.expand(-1, -1, size[1])], dim=1).float()
