"""RT-MonoDepth-S (Feng et al. 2024): depth of real streets in metres.

Attributes have the names in the authors' files ``encoder.pth`` and ``depth.pth``, in their folder
``s/ms_640_192``.
"""

from collections import OrderedDict
from itertools import pairwise

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from models.encoder.heads import resize_map, scaled_by_focal

# Size (H, W) of the network's training images in pixels. At other sizes, its depth is wrong.
SIZE = (192, 640)
# Mean of the values of images, which are from 0 to 1.
MEAN = 0.45
# Standard deviation of these values.
STD = 0.225
# Channels of the encoder at 1/2, 1/4, 1/8 and 1/16 of the image.
WIDTHS = (64, 64, 128, 192)
# Channels of the decoder at 1/8, 1/4, 1/2 and 1/1 of the image.
DECODED = (96, 64, 32, 16)
# Focal length of the training images, divided by their width.
KITTI_FOCAL = 721.5377 / 1242
# Metres per unit of the network's depth. In training, KITTI's stereo baseline of 0.54 m was 0.1.
STEREO_M = 5.4
# Smallest depth in the network's units.
NEAR = 0.1
# Largest depth in the network's units.
FAR = 100.0


class RTMonoDepthS(nn.Module):
    """RGB image [B,3,H,W] from 0 to 1 and intrinsics [B,3,3] → depth [B,H,W] in metres.

    It estimates depth from the size of objects at KITTI's focal length, and assumes the height of
    KITTI's camera.
    """

    def __init__(self) -> None:
        super().__init__()
        self.encoder = Encoder()
        self.decoder = Decoder()

    def forward(self, image: Tensor, K: Tensor) -> Tensor:
        normalised = (resize_map(image, SIZE) - MEAN) / STD
        nearness = self.decoder(self.encoder(normalised))
        inverse = 1 / FAR + (1 / NEAR - 1 / FAR) * nearness
        inverse = resize_map(inverse, image.shape[-2:])[:, 0]
        return scaled_by_focal(STEREO_M / inverse, K, KITTI_FOCAL)


class Encoder(nn.Module):
    def __init__(self) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(3, WIDTHS[0], 7, stride=2, padding=3, bias=False)
        self.convs = nn.Sequential()
        for inputs, outputs in pairwise(WIDTHS):
            halving = nn.Conv2d(inputs, outputs, 3, stride=2, padding=1)
            conv = nn.Conv2d(outputs, outputs, 3, padding=1)
            self.convs.append(nn.Sequential(halving, nn.LeakyReLU(0.1), conv, nn.LeakyReLU(0.1)))

    def forward(self, image: Tensor) -> Tensor:
        """Return the map at 1/16 of the image.

        The published decoder has no skip connections, so it needs no other map.
        """
        return self.convs(F.relu(self.conv1(image)))


class Decoder(nn.Module):
    def __init__(self) -> None:
        super().__init__()
        self.decoder = nn.ModuleList()
        for inputs, outputs in pairwise((WIDTHS[-1], *DECODED)):
            self.decoder += [conv_elu(inputs, outputs), conv_elu(outputs, outputs)]
        head = nn.Conv2d(DECODED[-1], 1, 3, padding=1)
        self.decoder.append(nn.Sequential(OrderedDict(conv3=head)))

    def forward(self, x: Tensor) -> Tensor:
        """Return inverse depth from 0 to 1, [B,1,16h,16w], of a map [B,192,h,w]."""
        for level in range(len(DECODED)):
            x = F.interpolate(self.decoder[2 * level](x), scale_factor=2, mode="nearest")
            x = self.decoder[2 * level + 1](x)
        # Half precision is too coarse for large depths.
        return torch.sigmoid(self.decoder[-1](x).float())


def conv_elu(inputs: int, outputs: int) -> nn.Sequential:
    """Return a 3x3 convolution with reflected edges, then ELU."""
    conv = nn.Conv2d(inputs, outputs, 3, padding=1, padding_mode="reflect")
    return nn.Sequential(OrderedDict(conv=conv, elu=nn.ELU()))
