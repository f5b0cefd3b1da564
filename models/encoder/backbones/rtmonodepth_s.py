"""RT-MonoDepth-S (Feng et al. 2024): depth of real streets in metres, and a class head on its features.

The authors' files ``encoder.pth`` and ``depth.pth`` of ``s/ms_640_192`` are the weights of backbone and depth head,
under Monodepth2's terms: non-commercial use only. The class head is fitted; backbone `street` has none.
"""

from collections import OrderedDict
from collections.abc import Mapping, Sequence
from itertools import pairwise

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from models.encoder.backbones import Backbone, Part, Parts, conv
from pipeline.camera import classes

SIZE = (192, 640)  # of its training images; depth is wrong at other sizes
WIDTHS = (64, 64, 128, 192)  # at 1/2, 1/4, 1/8 and 1/16 of the image
DECODED = (96, 64, 32, 16)  # at 1/8, 1/4, 1/2 and 1/1
COARSER = ("decoder.9.", "decoder.10.")  # heads at 1/2 and 1/4, for its training only
KITTI_FOCAL = 721.5377 / 1242  # focal length by image width of its training images
STEREO_M = 5.4  # metres per unit: KITTI's baseline of 0.54 m is 0.1 in its training
NEAR, FAR = 0.1, 100.0  # range of depth in units
CLASS_WIDTH = 48
DROPPED = 0.1  # share of features dropped in training


def rtmonodepth_s() -> Parts:
    """Return the parts; the class head has no published weights."""
    return Parts(Encoder(), Depth(), Classes())


def street() -> Parts:
    """Return the parts with a class head that has nothing to fit: all pixels are void.

    For visual odometry, which finds traffic by its own motion.
    """
    return Parts(Encoder(), Depth(), Void())


class Encoder(Backbone):
    """Image, resized to SIZE → maps at 1/2, 1/4, 1/8 and 1/16 of SIZE."""

    mean, std = (0.45,) * 3, (0.225,) * 3

    def __init__(self) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(3, WIDTHS[0], 7, stride=2, padding=3, bias=False)
        self.convs = nn.ModuleList(
            nn.Sequential(
                nn.Conv2d(inputs, outputs, 3, stride=2, padding=1),
                nn.LeakyReLU(0.1),
                nn.Conv2d(outputs, outputs, 3, padding=1),
                nn.LeakyReLU(0.1),
            )
            for inputs, outputs in pairwise(WIDTHS)
        )

    def forward(self, image: Tensor, rays: Tensor) -> list[Tensor]:
        """Return maps [B,WIDTHS[l],192/2^(l+1),640/2^(l+1)] of an image [B,3,H,W]."""
        maps = [F.relu(self.conv1(resized(image, SIZE)))]
        for layer in self.convs:
            maps.append(layer(maps[-1]))
        return maps


class Depth(Part):
    """The published decoder, without skips: inverse depth from the coarsest map, upsampled four times.

    It estimates depth from the size of objects at KITTI's focal length, so its depth is multiplied by the ratio of the
    focal lengths. It assumes the height of KITTI's camera.
    """

    def __init__(self) -> None:
        super().__init__()
        layers: list[nn.Module] = []
        for inputs, outputs in pairwise((WIDTHS[-1], *DECODED)):
            layers += [ConvELU(inputs, outputs), ConvELU(outputs, outputs)]
        layers.append(nn.Sequential(OrderedDict(conv3=nn.Conv2d(DECODED[-1], 1, 3, padding=1))))
        self.decoder = nn.ModuleList(layers)

    def forward(self, maps: Sequence[Tensor], rays: Tensor) -> Tensor:
        """Return depth [B,H,W] in metres."""
        x = maps[-1]
        for level in range(len(DECODED)):
            x = F.interpolate(self.decoder[2 * level](x), scale_factor=2, mode="nearest")
            x = self.decoder[2 * level + 1](x)
        near = torch.sigmoid(self.decoder[-1](x).float())  # half precision is too coarse for large depths
        inverse = resized(1 / FAR + (1 / NEAR - 1 / FAR) * near, rays.shape[-2:])[:, 0]
        return STEREO_M * (focal_by_width(rays) / KITTI_FOCAL)[:, None, None] / inverse

    def convert_names(self, published: Mapping[str, Tensor]) -> dict[str, Tensor]:
        return {name: tensor for name, tensor in published.items() if not name.startswith(COARSER)}


class ConvELU(nn.Module):
    """A 3x3 convolution with reflected edges, then ELU."""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.conv = nn.Conv2d(inputs, outputs, 3, padding=1, padding_mode="reflect")

    def forward(self, x: Tensor) -> Tensor:
        return F.elu(self.conv(x))


class Classes(Part):
    """Class head: maps at 1/16, 1/8 and 1/4 and the mean over the image, merged from coarse to fine."""

    def __init__(self) -> None:
        super().__init__()
        self.whole = nn.Conv2d(WIDTHS[3], CLASS_WIDTH, 1)
        self.sides = nn.ModuleList(nn.Conv2d(width, CLASS_WIDTH, 1) for width in WIDTHS[:0:-1])
        self.around = conv(CLASS_WIDTH, CLASS_WIDTH, dilation=2)
        self.merges = nn.ModuleList(conv(CLASS_WIDTH, CLASS_WIDTH) for _ in WIDTHS[2:])
        self.drop = nn.Dropout2d(DROPPED)
        self.last = nn.Conv2d(CLASS_WIDTH, classes.COUNT, 1)

    def forward(self, maps: Sequence[Tensor], rays: Tensor) -> Tensor:
        """Return logits [B,19,H,W]."""
        coarse, *finer = maps[:0:-1]
        y = self.sides[0](self.drop(coarse)) + self.whole(coarse.mean(dim=(2, 3), keepdim=True))
        y = y + self.around(y)
        for side, merge, x in zip(self.sides[1:], self.merges, finer, strict=True):
            y = merge(F.relu(resized(y, x.shape[-2:]) + side(self.drop(x))))
        return resized(self.last(y), rays.shape[-2:])


class Void(Part):
    """A class head without parameters."""

    def forward(self, maps: Sequence[Tensor], rays: Tensor) -> Tensor:
        """Return logits [B,20,H,W], 1 for void and 0 for all classes."""
        logits = rays.new_zeros(len(rays), classes.COUNT + 1, *rays.shape[-2:])
        logits[:, -1] = 1
        return logits


def resized(x: Tensor, size: Sequence[int]) -> Tensor:
    """Interpolate a map [B,C,h,w] to `size`, with averages where it shrinks; pixel centres stay aligned."""
    if x.shape[-2:] == torch.Size(size):
        return x
    return F.interpolate(x, tuple(size), mode="bilinear", align_corners=False, antialias=True)


def focal_by_width(rays: Tensor) -> Tensor:
    """Return focal length / image width, [B], from the slopes [B,2,H,W] of the pixels."""
    width = rays.shape[-1]
    return (1 - 1 / width) / (rays[:, 0, 0, -1] - rays[:, 0, 0, 0])
