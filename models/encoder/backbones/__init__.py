"""Backbones of the unified encoder, one file each, and their common interface."""

import re
from collections.abc import Mapping, Sequence
from types import ModuleType
from typing import NamedTuple

from torch import Tensor, nn


class Part(nn.Module):
    """A part of the unified encoder: backbone, depth head or class head."""

    def convert_names(self, published: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Return a published file's tensors under this network's names; unknown tensors keep their names."""
        return dict(published)


class Backbone(Part):
    """Compute the features that both heads read.

    ``forward(image [B,3,H,W], rays [B,2,H,W]) -> features``, for any H and W. The type of the features is private to a
    backbone and its heads.

    The image is (RGB/255 - mean) / std. `rays` are the slopes x/z and y/z of each pixel's ray: at a fixed camera height
    y/z determines the depth of the ground for any focal length. Backbones pretrained on images ignore them.
    """

    mean: tuple[float, float, float]
    std: tuple[float, float, float]


class Parts(NamedTuple):
    """A backbone and its two heads, each ``forward(features, rays [B,2,H,W])``.

    The depth head returns metres [B,H,W]. The class head returns logits [B,19,H,W], or [B,20,H,W] with void last.
    """

    backbone: Backbone
    depth_head: Part
    class_head: Part


IMAGENET_MEAN = (0.485, 0.456, 0.406)
IMAGENET_STD = (0.229, 0.224, 0.225)


def conv(inputs: int, outputs: int, stride: int = 1, dilation: int = 1) -> nn.Sequential:
    """Return a 3x3 convolution, batch norm and ReLU; stride 2 halves the size, rounded up."""
    return nn.Sequential(
        nn.Conv2d(inputs, outputs, 3, stride, padding=dilation, dilation=dilation, bias=False),
        nn.BatchNorm2d(outputs),
        nn.ReLU(inplace=True),
    )


def renamed(name: str, patterns: Sequence[tuple[str, str]]) -> str:
    """Return a tensor's name after all replacements of (regular expression, replacement), in order."""
    for pattern, new in patterns:
        name = re.sub(pattern, new, name)
    return name


def transformers() -> ModuleType:
    """Return Hugging Face's package. Raises ValueError if it is not installed."""
    try:
        import transformers
    except ImportError as error:
        raise ValueError("this backbone needs the package transformers: pip install '.[pretrained]'") from error
    return transformers
