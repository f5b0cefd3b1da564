"""EfficientViT-Seg-B0 (Cai et al. 2023): Cityscapes' 19 classes by 0.7 M parameters.

Attributes have the names of the authors' checkpoint ``efficientvit_seg_b0_cityscapes``.
"""

from collections import OrderedDict

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from pipeline.camera import classes

MEAN, STD = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)
STRIDE = 32  # sides of its image are multiples of it
WIDTHS = (8, 16, 32, 64, 128)  # at 1/2, 1/4, … 1/32 of the image
DECODED = 32
HEAD_WIDTH = 16  # of the attention


class EfficientViT(nn.Module):
    """RGB image [B,3,H,W] from 0 to 1, H and W multiples of 32 → logits [B,19,H/8,W/8]."""

    mean_std: Tensor

    def __init__(self) -> None:
        super().__init__()
        self.backbone, self.head = Backbone(), Head()
        # [2,3,1,1]
        self.register_buffer(
            "mean_std", torch.tensor([MEAN, STD])[..., None, None], persistent=False
        )

    def forward(self, image: Tensor) -> Tensor:
        mean, std = self.mean_std
        return self.head(self.backbone((image - mean) / std))


class Backbone(nn.Module):
    def __init__(self) -> None:
        super().__init__()
        first, *widths = WIDTHS
        depth_conv = conv(first, first, 3, groups=first).append(nn.Hardswish())
        separable = named(depth_conv=depth_conv, point_conv=conv(first, first))
        self.input_stem = ops(
            conv(3, first, 3, stride=2).append(nn.Hardswish()), Residual(separable)
        )
        self.stages, inputs = nn.ModuleList(), first
        for level, width in enumerate(widths):
            attention = level >= 2  # its convolutions have a bias instead of a batch norm
            blocks = (
                [attention_block(width) for _ in range(2)]
                if attention
                else [Residual(bottleneck(width, width))]
            )
            self.stages.append(
                ops(named(main=bottleneck(inputs, width, 2, bias=attention)), *blocks)
            )
            inputs = width

    def forward(self, x: Tensor) -> list[Tensor]:
        """Return maps at 1/8, 1/16 and 1/32 of the image."""
        x, maps = self.input_stem(x), []
        for stage in self.stages:
            x = stage(x)
            maps.append(x)
        return maps[1:]


class Head(nn.Module):
    def __init__(self) -> None:
        super().__init__()
        fine, middle, coarse = (conv(width, DECODED) for width in WIDTHS[2:])
        doubled, fourfold = (nn.Upsample(scale_factor=factor, mode="bicubic") for factor in (2, 4))
        self.input_ops = nn.ModuleList([ops(coarse, fourfold), ops(middle, doubled), fine])
        self.middle = ops(Residual(bottleneck(DECODED, DECODED)))
        last = named(conv=nn.Conv2d(4 * DECODED, classes.COUNT, 1))
        self.output_ops = nn.ModuleList(
            [ops(conv(DECODED, 4 * DECODED).append(nn.Hardswish()), last)]
        )

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
    """Multi-scale attention with ReLU instead of softmax: its cost grows linearly with the number
    of pixels.
    """

    def __init__(self, width: int) -> None:
        super().__init__()
        inner = 3 * width
        self.qkv = named(conv=nn.Conv2d(width, inner, 1, bias=False))
        depthwise = nn.Conv2d(inner, inner, 5, padding=2, groups=inner, bias=False)
        grouped = nn.Conv2d(inner, inner, 1, groups=inner // HEAD_WIDTH, bias=False)
        self.aggreg = nn.ModuleList([nn.Sequential(depthwise, grouped)])
        self.proj = conv(2 * width, width)

    def forward(self, x: Tensor) -> Tensor:
        qkv = self.qkv(x)
        scales = torch.cat([qkv, self.aggreg[0](qkv)], dim=1)  # [B,6C,H,W]
        # sums over all pixels are inaccurate in half precision
        with torch.autocast(x.device.type, enabled=False):
            heads = scales.float().reshape(len(x), -1, 3 * HEAD_WIDTH, x[0, 0].numel())
            q, k, v = heads.chunk(3, dim=2)  # [B,heads,16,HW]
            v = F.pad(v, (0, 0, 0, 1), value=1)  # its last row sums up the weights
            out = v @ F.relu(k).transpose(2, 3) @ F.relu(q)
            out = out[:, :, :-1] / (out[:, :, -1:] + 1e-15)
        return self.proj(out.reshape(len(x), -1, *x.shape[-2:]).to(qkv.dtype))


def conv(
    inputs: int,
    outputs: int,
    size: int = 1,
    *,
    stride: int = 1,
    groups: int = 1,
    bias: bool = False,
) -> nn.Sequential:
    """Return a convolution and, unless it has a bias, batch norm."""
    norm = {} if bias else {"norm": nn.BatchNorm2d(outputs)}
    return named(
        conv=nn.Conv2d(inputs, outputs, size, stride, size // 2, groups=groups, bias=bias), **norm
    )


def bottleneck(inputs: int, outputs: int, stride: int = 1, *, bias: bool = False) -> nn.Sequential:
    """Return an inverted bottleneck of 4 times the width of its inputs."""
    width = 4 * inputs
    return named(
        inverted_conv=conv(inputs, width, bias=bias).append(nn.Hardswish()),
        depth_conv=conv(width, width, 3, stride=stride, groups=width, bias=bias).append(
            nn.Hardswish()
        ),
        point_conv=conv(width, outputs),
    )


def attention_block(width: int) -> nn.Sequential:
    """Return attention over the image, then a bottleneck, each with a skip connection."""
    context = Residual(LinearAttention(width))
    return named(context_module=context, local_module=Residual(bottleneck(width, width, bias=True)))


def ops(*layers: nn.Module) -> nn.Sequential:
    """Return the layers in sequence; the checkpoint names such a sequence op_list."""
    return named(op_list=nn.Sequential(*layers))


def named(**layers: nn.Module) -> nn.Sequential:
    return nn.Sequential(OrderedDict(layers))
