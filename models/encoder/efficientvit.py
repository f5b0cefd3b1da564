"""EfficientViT-Seg-B0 (Cai et al. 2023), which predicts Cityscapes' 19 classes.

It has 0.7 million parameters. Attributes have the names in the authors' checkpoint
``efficientvit_seg_b0_cityscapes``.
"""

from collections import OrderedDict

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from pipeline.camera import classes

# Mean of the colours R, G, B in the training images.
MEAN = (0.485, 0.456, 0.406)
# Standard deviation of these colours.
STD = (0.229, 0.224, 0.225)
# Number of pixels that must divide the sides of an image.
STRIDE = 32
# Channels at 1/2, 1/4, 1/8, 1/16 and 1/32 of the image.
WIDTHS = (8, 16, 32, 64, 128)
# Channels of the map that the class head decodes.
DECODED = 32
# Channels of each head of the attention.
HEAD_WIDTH = 16


class EfficientViT(nn.Module):
    """RGB image [B,3,H,W] from 0 to 1, H and W multiples of 32 → logits [B,19,H/8,W/8]."""

    mean_std: Tensor

    def __init__(self) -> None:
        super().__init__()
        self.backbone = Backbone()
        self.head = Head()
        mean_std = torch.tensor([MEAN, STD])[..., None, None]  # [2,3,1,1]
        self.register_buffer("mean_std", mean_std, persistent=False)

    def forward(self, image: Tensor) -> Tensor:
        mean, std = self.mean_std
        return self.head(self.backbone((image - mean) / std))


class Backbone(nn.Module):
    def __init__(self) -> None:
        super().__init__()
        first, *widths = WIDTHS
        depth_conv = conv_norm(first, first, 3, groups=first).append(nn.Hardswish())
        separable = name_layers(depth_conv=depth_conv, point_conv=conv_norm(first, first))
        halving = conv_norm(3, first, 3, stride=2).append(nn.Hardswish())
        self.input_stem = op_list(halving, Residual(separable))

        # The stages halve the map. The last two have attention, and convolutions with a bias
        # instead of a batch norm.
        self.stages = nn.ModuleList()
        inputs = first
        for level, width in enumerate(widths):
            attention = level >= 2
            blocks: list[nn.Module] = []
            if attention:
                blocks += [attention_block(width), attention_block(width)]
            else:
                blocks.append(Residual(bottleneck(width, width)))
            main = bottleneck(inputs, width, 2, bias=attention)
            self.stages.append(op_list(name_layers(main=main), *blocks))
            inputs = width

    def forward(self, x: Tensor) -> list[Tensor]:
        """Return maps at 1/8, 1/16 and 1/32 of the image."""
        x = self.input_stem(x)
        maps = []
        for stage in self.stages:
            x = stage(x)
            maps.append(x)
        return maps[1:]


class Head(nn.Module):
    def __init__(self) -> None:
        super().__init__()
        *_, fine, middle, coarse = WIDTHS
        from_fine = conv_norm(fine, DECODED)
        doubled = nn.Upsample(scale_factor=2, mode="bicubic")
        from_middle = op_list(conv_norm(middle, DECODED), doubled)
        fourfold = nn.Upsample(scale_factor=4, mode="bicubic")
        from_coarse = op_list(conv_norm(coarse, DECODED), fourfold)
        self.input_ops = nn.ModuleList([from_coarse, from_middle, from_fine])
        self.middle = op_list(Residual(bottleneck(DECODED, DECODED)))
        logits = name_layers(conv=nn.Conv2d(4 * DECODED, classes.COUNT, 1))
        wide = conv_norm(DECODED, 4 * DECODED).append(nn.Hardswish())
        self.output_ops = nn.ModuleList([op_list(wide, logits)])

    def forward(self, maps: list[Tensor]) -> Tensor:
        x = sum(side(x) for side, x in zip(self.input_ops, reversed(maps), strict=True))
        return self.output_ops[0](self.middle(x))


class Residual(nn.Module):
    def __init__(self, main: nn.Module) -> None:
        super().__init__()
        self.main = main

    def forward(self, x: Tensor) -> Tensor:
        return x + self.main(x)


class LinearAttention(nn.Module):
    """Multi-scale attention with ReLU instead of softmax.

    Its cost grows linearly with the number of pixels.
    """

    def __init__(self, width: int) -> None:
        super().__init__()
        inner = 3 * width
        self.qkv = name_layers(conv=nn.Conv2d(width, inner, 1, bias=False))
        depthwise = nn.Conv2d(inner, inner, 5, padding=2, groups=inner, bias=False)
        grouped = nn.Conv2d(inner, inner, 1, groups=inner // HEAD_WIDTH, bias=False)
        self.aggreg = nn.ModuleList([nn.Sequential(depthwise, grouped)])
        self.proj = conv_norm(2 * width, width)

    def forward(self, x: Tensor) -> Tensor:
        batch, _, height, width = x.shape
        qkv = self.qkv(x)
        scales = torch.cat([qkv, self.aggreg[0](qkv)], dim=1)  # [B,6C,H,W]
        # Sums over all pixels are inaccurate in half precision.
        with torch.autocast(x.device.type, enabled=False):
            heads = scales.float().reshape(batch, -1, 3 * HEAD_WIDTH, height * width)
            q, k, v = heads.chunk(3, dim=2)  # [B,heads,16,HW]
            v = F.pad(v, (0, 0, 0, 1), value=1)  # the row of ones sums up the weights
            sums = v @ F.relu(k).transpose(2, 3) @ F.relu(q)
            out = sums[:, :, :-1] / (sums[:, :, -1:] + 1e-15)
        return self.proj(out.reshape(batch, -1, height, width).to(qkv.dtype))


def conv_norm(
    inputs: int,
    outputs: int,
    size: int = 1,
    *,
    stride: int = 1,
    groups: int = 1,
    bias: bool = False,
) -> nn.Sequential:
    """Return a convolution, followed by a batch norm unless the convolution has a bias."""
    layer = nn.Conv2d(inputs, outputs, size, stride, size // 2, groups=groups, bias=bias)
    if bias:
        return name_layers(conv=layer)
    return name_layers(conv=layer, norm=nn.BatchNorm2d(outputs))


def bottleneck(inputs: int, outputs: int, stride: int = 1, *, bias: bool = False) -> nn.Sequential:
    """Return an inverted bottleneck of 4 times the width of its inputs."""
    width = 4 * inputs
    inverted = conv_norm(inputs, width, bias=bias).append(nn.Hardswish())
    depth = conv_norm(width, width, 3, stride=stride, groups=width, bias=bias).append(
        nn.Hardswish()
    )
    return name_layers(
        inverted_conv=inverted, depth_conv=depth, point_conv=conv_norm(width, outputs)
    )


def attention_block(width: int) -> nn.Sequential:
    """Return attention over the image, then a bottleneck, each with a skip connection."""
    context = Residual(LinearAttention(width))
    return name_layers(
        context_module=context, local_module=Residual(bottleneck(width, width, bias=True))
    )


def op_list(*layers: nn.Module) -> nn.Sequential:
    """Return the layers in sequence; the checkpoint names such a sequence op_list."""
    return name_layers(op_list=nn.Sequential(*layers))


def name_layers(**layers: nn.Module) -> nn.Sequential:
    """Return the layers in sequence, with the names of the arguments."""
    return nn.Sequential(OrderedDict(layers))
