"""Encoders: networks of metric depth and Cityscapes classes of an image (paper §3.2), by a description of them.

An encoder is a module ``forward(image, K) -> (depth, logits)``:

- image: RGB [B,3,H,W], uint8, or floats from 0 to 1.
- K: pinhole intrinsics [B,3,3] at this image size.
- depth: [B,H,W], metres along the optical axis.
- logits: of Cityscapes' classes, [B,19,H,W], or [B,20,H,W] with void last.
"""

from collections.abc import Callable, Mapping
from typing import Any

import torch
from torch import Tensor, nn

from models.encoder.dinov2 import DinoV2
from models.encoder.heads import ray_slopes, rgb_0_1
from models.encoder.hugging_face import HuggingFace, Pair
from models.encoder.small import small
from models.encoder.street import Street

Architecture = Mapping[str, Any]
"""JSON-able description of an encoder, complete without a hub; ``backbone`` is a key of BUILD."""


class UnifiedEncoder(nn.Module):
    """One backbone with two heads.

    ``backbone(image [B,3,H,W], rays [B,2,H,W]) -> features``, for any H and W, of (RGB/255 - mean) / std with its
    attributes `mean` and `std`; the type of the features is private to a backbone and its heads. `rays` are the slopes
    x/z and y/z of each pixel's ray: at a fixed camera height y/z determines the depth of the ground for any focal
    length. Each head is a ``forward(features, rays)``.
    """

    mean_std: Tensor

    def __init__(self, backbone: Any, depth_head: nn.Module, class_head: nn.Module) -> None:
        super().__init__()
        self.backbone, self.depth_head, self.class_head = backbone, depth_head, class_head
        # A buffer: a tensor made of numbers would be a blocking copy to a GPU in each pass.
        mean_std = torch.tensor([backbone.mean, backbone.std])
        self.register_buffer("mean_std", mean_std[..., None, None], persistent=False)  # [2,3,1,1]

    def forward(self, image: Tensor, K: Tensor) -> tuple[Tensor, Tensor]:
        """Return depth and logits, see above."""
        rgb = rgb_0_1(image)
        mean, std = self.mean_std.to(rgb.dtype)
        rays = ray_slopes(K, image.shape[-2:])
        features = self.backbone((rgb - mean) / std, rays)
        return self.depth_head(features, rays), self.class_head(features, rays)


BUILD: dict[str, Callable[[Architecture], nn.Module]] = {
    "small": lambda architecture: UnifiedEncoder(*small()),
    "street": lambda architecture: Street(),
    "pair": Pair,
    "hugging_face": HuggingFace,
    "dinov2": DinoV2,
}


def build(architecture: Architecture) -> nn.Module:
    """Return the encoder that `architecture` describes, with random weights.

    Raises ValueError if its kind is unknown, or if a package is missing.
    """
    if architecture["backbone"] not in BUILD:
        raise ValueError(f"unknown backbone {architecture['backbone']!r} (known: {', '.join(BUILD)})")
    return BUILD[architecture["backbone"]](architecture)
