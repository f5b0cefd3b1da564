"""The backbones of the unified encoder, one file each, and what all of them promise."""

import re
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from torch import Tensor, nn


class Part(nn.Module):
    """A part of the unified encoder, which a published checkpoint may fill."""

    def own_names(self, published: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Return a published file's tensors under this network's names; what it does not know keeps its name."""
        return dict(published)


class Backbone(Part):
    """Makes the features that both heads read.

    ``forward(image [B,3,H,W], rays [B,2,H,W]) -> features``, for any H and W; what the features are is between a
    backbone and its heads.

    The image arrives as (RGB/255 - mean) / std. `rays` are the slopes x/z and y/z of each pixel's ray: at a fixed
    camera height y/z tells the depth of the ground, whatever the focal length. A backbone that was pretrained on images
    alone leaves them unused.
    """

    mean: tuple[float, float, float]
    std: tuple[float, float, float]


class Parts(NamedTuple):
    """One backbone with its two heads, each ``forward(features, rays [B,2,H,W])``.

    The depth head returns metres [B,H,W]. The class head returns logits [B,19,H,W], or [B,20,H,W] whose last is void.
    """

    backbone: Backbone
    depth_head: Part
    class_head: Part


IMAGENET_MEAN = (0.485, 0.456, 0.406)
IMAGENET_STD = (0.229, 0.224, 0.225)


def renamed(name: str, patterns: Sequence[tuple[str, str]]) -> str:
    """Return a tensor's name after all replacements of (regular expression, replacement), one after the other."""
    for pattern, new in patterns:
        name = re.sub(pattern, new, name)
    return name
