"""A depth head that corrects the flat ground seen by a camera of known height, so that few scans can teach it."""

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from models.backbones import Part
from models.heads import MAX_DEPTH_M, MIN_DEPTH_M

CAMERA_HEIGHT_M = 1.65  # KITTI's, and the sample's
GROUND = (0, 1, 9)  # road, sidewalk, terrain
MAX_GROUND_M = 80.0
WIDTH = 32
MAX_CORRECTION = 0.7  # of the logarithm: half as far to twice as far


class GroundDepth(Part):
    """Flat ground times the exponential of a bounded correction; without any fitting, the flat ground itself.

    Its features are a tuple: a coarse map [B,coarse,h/8,w/8], a fine one [B,fine,h,w] at half the size of the (padded)
    image, and class logits [B,≥19,h,w].
    """

    def __init__(self, coarse: int, fine: int) -> None:
        super().__init__()
        self.coarse, self.fine = nn.Conv2d(coarse, WIDTH, 1), nn.Conv2d(fine, WIDTH, 1)
        last = nn.Conv2d(WIDTH, 4, 1, bias=False)
        nn.init.zeros_(last.weight)
        self.layers = nn.Sequential(nn.ReLU(), nn.Conv2d(WIDTH, WIDTH, 3, padding=2, dilation=2), nn.ReLU(), last)

    def forward(self, features: tuple[Tensor, Tensor, Tensor], rays: Tensor) -> Tensor:
        """Return depth [B,H,W] in metres of the image whose rays are [B,2,H,W]."""
        coarse, fine, logits = features
        height, width = rays.shape[-2:]
        x = F.interpolate(self.coarse(coarse), fine.shape[-2:], mode="bilinear", align_corners=False) + self.fine(fine)
        correction = F.pixel_shuffle(self.layers(x), 2)[:, 0, :height, :width]
        with torch.no_grad():
            size = 2 * fine.shape[-2], 2 * fine.shape[-1]
            cls = F.interpolate(logits, size, mode="bilinear", align_corners=True).argmax(dim=1)[:, :height, :width]
            flat = ground_plane_depth(cls, rays)
        return (flat * torch.exp(MAX_CORRECTION * torch.tanh(correction))).clamp(MIN_DEPTH_M, MAX_DEPTH_M)


def ground_plane_depth(cls: Tensor, rays: Tensor) -> Tensor:
    """Return the depth [B,H,W] in metres of flat ground, and of what stands on it.

    What is no ground is as far as the nearest ground below it in its column, or where the image ends.

    Args:
        cls: trainIds [B,H,W].
        rays: slopes x/z and y/z [B,2,H,W] of a level camera's pixels; y/z is the same along a row.
    """
    slope = rays[:, 1].clamp(min=CAMERA_HEIGHT_M / MAX_DEPTH_M)  # [B,H,W]
    plane = CAMERA_HEIGHT_M / slope
    ground = torch.isin(cls, cls.new_tensor(GROUND)) & (plane < MAX_GROUND_M)
    height = cls.shape[-2]
    rows = torch.arange(height, device=cls.device)[:, None].expand_as(cls)
    nearest = torch.where(ground, rows, height - 1).flip(-2).cummin(dim=-2).values.flip(-2)
    return plane.gather(-2, nearest)
