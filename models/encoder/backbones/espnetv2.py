"""ESPNetv2 with its segmentation decoder (Mehta et al. 2019).

Designed for CPUs: 0.8 M parameters at scale 2. Attributes have the names of the authors' Cityscapes checkpoints.
"""

import math
from collections import OrderedDict
from typing import NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from models.encoder.backbones import IMAGENET_MEAN, IMAGENET_STD, Backbone, Part, Parts
from models.encoder.heads import GroundDepth
from pipeline.camera import classes

CHANNELS = {1.0: (32, 64, 128, 256), 2.0: (32, 128, 256, 512)}  # at 1/2, 1/4, 1/8 and 1/16 of the image
DECODED = (64, 48, 32)  # the decoder's channels at 1/16, 1/8 and 1/4, each before doubling the size
STRIDE = 16
LOGITS = classes.COUNT + 1  # Cityscapes' 19 classes and background
BRANCHES = 4
PYRAMID = (2.0, 1.5, 1.0, 0.5, 0.1)  # scales of the pyramid pooling


def espnetv2(scale: float) -> Parts:
    """Return the parts of a network of width `scale`, 1.0 or 2.0."""
    return Parts(ESPNetv2(scale), DecodedDepth(), DecodedClasses())


class Features(NamedTuple):
    """The decoder's features [B,32,h,w] and logits [B,20,h,w], at half the size of the padded image."""

    decoded: Tensor
    logits: Tensor


class ESPNetv2(Backbone):
    """Image → the decoder's features and the logits of 20 classes."""

    mean, std = IMAGENET_MEAN, IMAGENET_STD

    def __init__(self, scale: float) -> None:
        super().__init__()
        a, b, c, d = CHANNELS[scale]
        self.base_net = Encoder(a, b, c, d)
        x, y, z = DECODED
        self.bu_dec_l1 = PyramidPooling(d, x)
        self.bu_dec_l2 = PyramidPooling(x, y)
        self.bu_dec_l3 = PyramidPooling(y, z)
        self.bu_dec_l4 = PyramidPooling(z, LOGITS, last=True)
        self.merge_enc_dec_l2, self.merge_enc_dec_l3 = Weighted(c, x), Weighted(b, y)
        self.merge_enc_dec_l4 = Weighted(a, z)
        self.bu_br_l2, self.bu_br_l3, self.bu_br_l4 = norm_act(x), norm_act(y), norm_act(z)

    def forward(self, image: Tensor, rays: Tensor) -> Features:
        """Return the features of an image [B,3,H,W]."""
        image = F.pad(image, (0, -image.shape[-1] % STRIDE, 0, -image.shape[-2] % STRIDE), mode="replicate")
        l1, l2, l3, l4 = self.base_net(image)
        y = self.bu_dec_l1(l4)  # [B,64,H/16,W/16]
        y = self.bu_dec_l2(self.bu_br_l2(self.merge_enc_dec_l2(l3) + doubled(y)))  # [B,48,H/8,W/8]
        y = self.bu_dec_l3(self.bu_br_l3(self.merge_enc_dec_l3(l2) + doubled(y)))  # [B,32,H/4,W/4]
        y = self.bu_br_l4(self.merge_enc_dec_l4(l1) + doubled(y))  # [B,32,H/2,W/2]
        return Features(y, self.bu_dec_l4(y))


class DecodedDepth(Part):
    """Depth of flat ground by the decoder's classes, corrected from the decoder's features."""

    def __init__(self) -> None:
        super().__init__()
        self.ground = GroundDepth(DECODED[-1], LOGITS)

    def forward(self, features: Features, rays: Tensor) -> Tensor:
        """Return depth [B,H,W] in metres."""
        depth: Tensor = self.ground(features.decoded, features.logits, rays)
        return depth


class DecodedClasses(Part):
    """The decoder's logits at the size of the image, without parameters."""

    def forward(self, features: Features, rays: Tensor) -> Tensor:
        """Return logits [B,20,H,W], void last."""
        return doubled(features.logits)[..., : rays.shape[-2], : rays.shape[-1]]


class Encoder(nn.Module):
    """The ImageNet network: three down-samplers that also read the image, and EESP blocks between them."""

    def __init__(self, a: int, b: int, c: int, d: int) -> None:
        super().__init__()
        self.level1 = conv(3, a, 3, stride=2)
        self.level2_0 = DownSampler(a, b, limit=13)
        self.level3_0 = DownSampler(b, c, limit=11)
        self.level3 = nn.Sequential(*(EESP(c, c, limit=9) for _ in range(3)))
        self.level4_0 = DownSampler(c, d, limit=9)
        self.level4 = nn.Sequential(*(EESP(d, d, limit=7) for _ in range(7)))

    def forward(self, image: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        l1 = self.level1(image)
        l2 = self.level2_0(l1, image)
        l3 = self.level3(self.level3_0(l2, image))
        l4 = self.level4(self.level4_0(l3, image))
        return l1, l2, l3, l4


class EESP(nn.Module):
    """Reduce, convolve depth-wise with increasing dilations, sum hierarchically, expand."""

    def __init__(self, inputs: int, outputs: int, limit: int, stride: int = 1) -> None:
        """`limit`: maximum receptive field in pixels; wider branches have 3."""
        super().__init__()
        n = outputs // BRANCHES
        fields = sorted(field if field <= limit else 3 for field in range(3, 3 + 2 * BRANCHES, 2))
        self.proj_1x1 = conv(inputs, n, 1, groups=BRANCHES)
        self.spp_dw = nn.ModuleList(depth_wise(n, stride, (field - 1) // 2) for field in fields)
        self.br_after_cat = named(bn=nn.BatchNorm2d(outputs), act=nn.PReLU(outputs))
        self.conv_1x1_exp = conv(outputs, outputs, 1, groups=BRANCHES, act=False)
        self.module_act = nn.PReLU(outputs)
        self.stride = stride

    def forward(self, x: Tensor) -> Tensor:
        reduced = self.proj_1x1(x)
        sums = [self.spp_dw[0](reduced)]
        for branch in self.spp_dw[1:]:
            sums.append(sums[-1] + branch(reduced))
        y = self.conv_1x1_exp(self.br_after_cat(torch.cat(sums, dim=1)))
        # A down-sampler applies its own activation after adding the image, so its block's module_act is unused.
        return y if self.stride == 2 else self.module_act(y + x)


class DownSampler(nn.Module):
    """Halve the size: an average, an EESP of stride 2, and the downsampled image."""

    def __init__(self, inputs: int, outputs: int, limit: int) -> None:
        super().__init__()
        self.eesp = EESP(inputs, outputs - inputs, limit, stride=2)
        self.inp_reinf = nn.Sequential(conv(3, 3, 3), conv(3, outputs, 1, act=False))
        self.act = nn.PReLU(outputs)

    def forward(self, x: Tensor, image: Tensor) -> Tensor:
        averaged = F.avg_pool2d(x, 3, stride=2, padding=1)
        while image.shape[-2] > averaged.shape[-2]:
            image = F.avg_pool2d(image, 3, stride=2, padding=1)
        return self.act(torch.cat([averaged, self.eesp(x)], dim=1) + self.inp_reinf(image))


class PyramidPooling(nn.Module):
    """Depth-wise convolutions at five scales of a map, merged."""

    def __init__(self, inputs: int, outputs: int, width: int = 10, last: bool = False) -> None:
        super().__init__()
        self.projection_layer = named(cbr=norm_act(width, nn.Conv2d(inputs, width, 1, bias=False)))
        self.stages = nn.ModuleList(nn.Conv2d(width, width, 3, 1, 1, groups=width, bias=False) for _ in PYRAMID)
        merged = nn.Conv2d(width * len(PYRAMID), width, 3, 1, 1, groups=width, bias=False)
        self.merge_layer = nn.Sequential(
            named(br=norm_act(width * len(PYRAMID))),
            nn.ChannelShuffle(len(PYRAMID)),
            named(cbr=norm_act(width, merged)),
            nn.Conv2d(width, outputs, 1, bias=last),
        )
        self.br = nn.Identity() if last else named(br=norm_act(outputs))

    def forward(self, x: Tensor) -> Tensor:
        x = self.projection_layer(x)
        height, width = x.shape[-2:]
        scales = []
        for scale, stage in zip(PYRAMID, self.stages, strict=True):
            size = max(5, math.ceil(height * scale)), max(5, math.ceil(width * scale))
            if scale < 1:
                scales.append(resized(stage(F.adaptive_avg_pool2d(x, size)), (height, width)))
            elif scale > 1:
                scales.append(F.adaptive_avg_pool2d(stage(resized(x, size)), (height, width)))
            else:
                scales.append(stage(x))
        return self.br(self.merge_layer(torch.cat(scales, dim=1)))


class Weighted(nn.Module):
    """An encoder's map for the decoder, with channels weighted by their means over the image."""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        groups = math.gcd(inputs, outputs)
        self.wt_layer = nn.Sequential(nn.AdaptiveAvgPool2d(1), nn.Conv2d(inputs, outputs, 1, bias=False), nn.Sigmoid())
        expanded = nn.Conv2d(inputs, outputs, 3, 1, 1, groups=groups, bias=False)
        self.expansion_layer = named(cbr=norm_act(outputs, expanded))

    def forward(self, x: Tensor) -> Tensor:
        return self.expansion_layer(x) * self.wt_layer(x)


def conv(inputs: int, outputs: int, size: int, stride: int = 1, groups: int = 1, act: bool = True) -> nn.Sequential:
    """Return a convolution with padding, batch norm, and PReLU if `act`."""
    layers: dict[str, nn.Module] = {
        "conv": nn.Conv2d(inputs, outputs, size, stride, padding=size // 2, groups=groups, bias=False),
        "bn": nn.BatchNorm2d(outputs),
    }
    return named(**layers, **({"act": nn.PReLU(outputs)} if act else {}))


def depth_wise(channels: int, stride: int, dilation: int) -> nn.Sequential:
    """Return a 3x3 convolution per channel."""
    return named(conv=nn.Conv2d(channels, channels, 3, stride, dilation, dilation, channels, bias=False))


def norm_act(channels: int, *before: nn.Module) -> nn.Sequential:
    """Return the layers `before`, batch norm and PReLU."""
    return nn.Sequential(*before, nn.BatchNorm2d(channels), nn.PReLU(channels))


def named(**layers: nn.Module) -> nn.Sequential:
    """Return a sequence of named layers."""
    return nn.Sequential(OrderedDict(layers))


def resized(x: Tensor, size: tuple[int, int]) -> Tensor:
    return F.interpolate(x, size, mode="bilinear", align_corners=True)  # as the network was trained


def doubled(x: Tensor) -> Tensor:
    return resized(x, (2 * x.shape[-2], 2 * x.shape[-1]))
