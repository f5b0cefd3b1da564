"""Metric depth and Cityscapes classes of an image by one backbone and two heads (paper §3.2)."""

from collections.abc import Callable
from functools import partial

import torch
from torch import Tensor, nn

from models.encoder.backbones import Parts
from models.encoder.backbones.dinov2 import dinov2
from models.encoder.backbones.espnetv2 import espnetv2
from models.encoder.backbones.rtmonodepth_s import rtmonodepth_s, street
from models.encoder.backbones.small import small
from models.encoder.backbones.swin import swin

BACKBONES: dict[str, Callable[[], Parts]] = {
    "small": small,
    "espnetv2": partial(espnetv2, 2.0),
    "espnetv2-s1": partial(espnetv2, 1.0),
    "dinov2-vits14": partial(dinov2, "vits14"),
    "dinov2-vitb14": partial(dinov2, "vitb14"),
    "dinov2-vitl14": partial(dinov2, "vitl14"),
    "swin-t": swin,
    "rtmonodepth-s": rtmonodepth_s,  # Monodepth2's terms: non-commercial use only
    "street": street,  # the same terms
}


class UnifiedEncoder(nn.Module):
    """Image and intrinsics → depth in metres and class logits of each pixel.

    The children `backbone`, `depth_head` and `class_head` are the Parts of ``models/encoder/backbones``.
    """

    mean_std: Tensor

    def __init__(self, backbone: str) -> None:
        """`backbone` is a key of BACKBONES. Raises ValueError if it is unknown or needs a missing package."""
        super().__init__()
        if backbone not in BACKBONES:
            raise ValueError(f"unknown backbone {backbone!r} (known: {', '.join(BACKBONES)})")
        self.backbone, self.depth_head, self.class_head = BACKBONES[backbone]()
        # A buffer: a tensor made of numbers would be a blocking copy to a GPU in each pass.
        mean_std = torch.tensor([self.backbone.mean, self.backbone.std])
        self.register_buffer("mean_std", mean_std[..., None, None], persistent=False)  # [2,3,1,1]

    def forward(self, image: Tensor, K: Tensor) -> tuple[Tensor, Tensor]:
        """Return depth [B,H,W], metres along the optical axis, and class logits [B,19,H,W], or 20 with void last.

        Args:
            image: RGB [B,3,H,W], uint8, or floats from 0 to 1.
            K: pinhole intrinsics [B,3,3] at this image size.
        """
        rgb = image.float() / 255 if image.dtype == torch.uint8 else image
        mean, std = self.mean_std.to(rgb.dtype)
        rgb = (rgb - mean) / std
        rays = ray_slopes(K, image.shape[-2:])
        features = self.backbone(rgb, rays)
        return self.depth_head(features, rays), self.class_head(features, rays)


def ray_slopes(K: Tensor, size: torch.Size) -> Tensor:
    """Return x/z and y/z of each pixel's ray, [B,2,H,W], for intrinsics [B,3,3] without skew."""
    v = torch.arange(size[0], dtype=K.dtype, device=K.device).view(1, -1, 1)
    u = torch.arange(size[1], dtype=K.dtype, device=K.device).view(1, 1, -1)
    x = (u - K[:, 0, 2, None, None]) / K[:, 0, 0, None, None]  # [B,1,W]
    y = (v - K[:, 1, 2, None, None]) / K[:, 1, 1, None, None]  # [B,H,1]
    return torch.stack([x.expand(-1, size[0], -1), y.expand(-1, -1, size[1])], dim=1).float()
