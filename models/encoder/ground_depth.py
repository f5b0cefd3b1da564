"""Depth head that corrects the depth of flat ground, so that a few scans suffice to fit it."""

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from models.encoder.heads import MAX_DEPTH_M, MIN_DEPTH_M
from pipeline.camera.classes import GROUND
from pipeline.camera.mount import CAMERA_HEIGHT_M

MAX_GROUND_M = 80.0  # beyond, a pixel covers many metres
WIDTH = 32
DROPPED = 0.2  # share of features dropped in training, against overfitting to one place
MAX_CORRECTION = 0.7  # of the logarithm: a factor of 0.5 to 2


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
    ground = torch.isin(cls, cls.new_tensor(GROUND)) & (plane < MAX_GROUND_M)
    height = cls.shape[-2]
    rows = torch.arange(height, device=cls.device)[:, None].expand_as(cls)
    nearest = torch.where(ground, rows, height - 1).flip(-2).cummin(dim=-2).values.flip(-2)
    return plane.gather(-2, nearest)
