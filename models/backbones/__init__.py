"""The backbones of the unified encoder, one file each, and what all of them promise."""

from torch import nn


class Backbone(nn.Module):
    """Makes one feature map that both heads read.

    ``forward(image [B,3,H,W], rays [B,2,H,W]) -> [B,channels,ceil(H/stride),ceil(W/stride)]``, for any H and W.

    The image arrives as (RGB/255 - mean) / std. `rays` are the slopes x/z and y/z of each pixel's ray: at a fixed
    camera height y/z tells the depth of the ground, whatever the focal length. A backbone that was pretrained on images
    alone leaves them unused.
    """

    channels: int
    stride: int
    mean: tuple[float, float, float]
    std: tuple[float, float, float]
