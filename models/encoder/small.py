"""Small convolutional encoder-decoder that can be fitted on a CPU within minutes."""

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from models.encoder.heads import CellClasses, CellDepth, Pointwise, ray_slopes

# Mean of the values of images, which are from 0 to 1.
MEAN = 0.45
# Standard deviation of these values.
STD = 0.25
# Stride in pixels of the map that both heads read.
STRIDE = 2
# Channels at 1/2, 1/4, 1/8 and 1/16 of the image.
WIDTHS = (16, 32, 64, 96)


class Small(nn.Module):
    """A backbone, a depth head and a class head. Both heads read the same map."""

    def __init__(self) -> None:
        super().__init__()
        self.backbone = UNet()
        self.depth_head = CellDepth(UNet.channels, STRIDE)
        self.class_head = CellClasses(UNet.channels, STRIDE)

    def forward(self, image: Tensor, K: Tensor) -> tuple[Tensor, Tensor]:
        # At a fixed camera height, the slope of a pixel's ray determines the depth of the ground,
        # for any focal length. So the rays are an input.
        rays = ray_slopes(K, image.shape[-2:])
        features = self.backbone((image.float() / 255 - MEAN) / STD, rays)
        return self.depth_head(features, rays), self.class_head(features, rays)


class UNet(nn.Module):
    """Convolutions that halve the map four times, then double it three times, with skips.

    The receptive field of a feature is most of the image.
    """

    # Channels of the result, twice those of the first map, since both heads read them.
    channels = 2 * WIDTHS[0]

    def __init__(self) -> None:
        super().__init__()
        a, b, c, d = WIDTHS
        self.down1 = conv3x3(3 + 2, a, stride=2)
        self.down2 = nn.Sequential(conv3x3(a, b, stride=2), Residual(b))
        self.down3 = nn.Sequential(conv3x3(b, c, stride=2), Residual(c))
        self.down4 = nn.Sequential(conv3x3(c, d, stride=2), Residual(d), Residual(d, dilation=2))
        # 1x1 convolutions from the channels of a smaller map to those of the next larger one.
        self.side3 = Pointwise(d, c)
        self.side2 = Pointwise(c, b)
        self.side1 = Pointwise(b, a)
        self.up3 = conv3x3(c, c)
        self.up2 = conv3x3(b, b)
        self.up1 = conv3x3(a, self.channels)

    def forward(self, image: Tensor, rays: Tensor) -> Tensor:
        """Return features [B,channels,ceil(H/2),ceil(W/2)].

        The image [B,3,H,W] is normalised. `rays` [B,2,H,W] are the slopes of its pixels' rays.
        """
        x1 = self.down1(torch.cat([image, rays], dim=1))  # [B,a,H/2,W/2]
        x2 = self.down2(x1)  # [B,b,H/4,W/4]
        x3 = self.down3(x2)  # [B,c,H/8,W/8]
        x4 = self.down4(x3)  # [B,d,H/16,W/16]
        y = self.up3(x3 + _repeat_pixels(self.side3(x4), x3))
        y = self.up2(x2 + _repeat_pixels(self.side2(y), x2))
        return self.up1(x1 + _repeat_pixels(self.side1(y), x1))  # [B,channels,H/2,W/2]


class Residual(nn.Module):
    """Two 3x3 convolutions with a skip connection."""

    def __init__(self, channels: int, dilation: int = 1) -> None:
        super().__init__()
        self.first = conv3x3(channels, channels, dilation=dilation)
        self.second = conv3x3(channels, channels, dilation=dilation)[:-1]  # ReLU follows the sum

    def forward(self, x: Tensor) -> Tensor:
        return F.relu(x + self.second(self.first(x)))


def conv3x3(inputs: int, outputs: int, stride: int = 1, dilation: int = 1) -> nn.Sequential:
    """Return a 3x3 convolution, batch norm and ReLU; stride 2 halves the size, rounded up."""
    layer = nn.Conv2d(inputs, outputs, 3, stride, padding=dilation, dilation=dilation, bias=False)
    return nn.Sequential(layer, nn.BatchNorm2d(outputs), nn.ReLU(inplace=True))


def _repeat_pixels(x: Tensor, like: Tensor) -> Tensor:
    return F.interpolate(x, size=like.shape[-2:], mode="nearest")
