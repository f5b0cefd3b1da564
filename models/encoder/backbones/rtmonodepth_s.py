"""RT-MonoDepth-S (Feng et al. 2024): depth of real streets in metres, beside the classes of ESPNetv2.

The authors' files ``encoder.pth`` and ``depth.pth`` of ``s/ms_640_192`` are the weights of backbone and depth head,
under Monodepth2's terms: non-commercial use only. Those of the class head are ESPNetv2's; backbone `street` has none.
"""

from collections import OrderedDict
from collections.abc import Mapping, Sequence
from itertools import pairwise

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from models.encoder.backbones import Backbone, Part, Parts
from models.encoder.backbones.espnetv2 import DecodedClasses, ESPNetv2
from pipeline.camera import classes

SIZE = (192, 640)  # of its training images; depth is wrong at other sizes
WIDTHS = (64, 64, 128, 192)  # at 1/2, 1/4, 1/8 and 1/16 of the image
DECODED = (96, 64, 32, 16)  # at 1/8, 1/4, 1/2 and 1/1
COARSER = ("decoder.9.", "decoder.10.")  # heads at 1/2 and 1/4, for its training only
KITTI_FOCAL = 721.5377 / 1242  # focal length by image width of its training images
STEREO_M = 5.4  # metres per unit: KITTI's baseline of 0.54 m is 0.1 in its training
NEAR, FAR = 0.1, 100.0  # range of depth in units


def rtmonodepth_s() -> Parts:
    """Return the parts; the class head reads the image, as the depth's features are poor in classes."""
    return Parts(Encoder(), Depth(), Classes())


def street() -> Parts:
    """Return the parts with a class head that has nothing to fit: all pixels are void.

    For visual odometry, which finds traffic by its own motion.
    """
    return Parts(Encoder(), Depth(), Void())


class Encoder(Backbone):
    """Image → itself, and maps of it resized to SIZE, at 1/2, 1/4, 1/8 and 1/16 of SIZE."""

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
        """Return an image [B,3,H,W] and its maps [B,WIDTHS[l],192/2^(l+1),640/2^(l+1)]."""
        maps = [image, F.relu(self.conv1(resized(image, SIZE)))]
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
    """ESPNetv2 as a class head; its published file has the weights."""

    colours: Tensor

    def __init__(self) -> None:
        super().__init__()
        self.network, self.resize = ESPNetv2(2.0), DecodedClasses()
        colours = torch.tensor([Encoder.std, ESPNetv2.mean, ESPNetv2.std])[..., None, None]
        self.register_buffer("colours", colours, persistent=False)  # [3,3,1,1]

    def forward(self, maps: Sequence[Tensor], rays: Tensor) -> Tensor:
        """Return logits [B,20,H,W], void last."""
        scale, mean, std = self.colours
        image = (maps[0] * scale + Encoder.mean[0] - mean) / std  # from the backbone's normalisation to its own
        logits: Tensor = self.resize(self.network(image, rays), rays)
        return logits

    def convert_names(self, published: Mapping[str, Tensor]) -> dict[str, Tensor]:
        return {f"network.{name}": tensor for name, tensor in published.items()}


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
