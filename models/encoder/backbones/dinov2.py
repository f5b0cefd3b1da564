"""DINOv2 (Oquab et al. 2023) with its authors' linear heads: KITTI depth in metres and ADE20K classes.

The backbone is Hugging Face's Dinov2Model, built from its sizes and filled from the authors' own files:
``dinov2_vits14_pretrain.pth``, ``dinov2_vits14_kitti_linear_head.pth``, ``dinov2_vits14_ade20k_linear_head.pth``.
"""

from collections.abc import Mapping
from typing import NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from models.encoder.backbones import IMAGENET_MEAN, IMAGENET_STD, Backbone, Part, Parts, renamed
from models.encoder.backbones.ade20k import ADE20K, to_cityscapes

PATCH = 14
SIZES = {"vits14": (384, 12, 6), "vitb14": (768, 12, 12), "vitl14": (1024, 24, 16)}  # width, layers, attention heads
MIN_DEPTH_M, MAX_DEPTH_M, BINS = 0.001, 80.0, 256  # of the KITTI heads; the authors' hub code has NYU's 10 m

NAMES = [
    (r"^patch_embed\.proj\.", "embeddings.patch_embeddings.projection."),
    (r"^(cls_token|mask_token)$", r"embeddings.\1"),
    (r"^pos_embed$", "embeddings.position_embeddings"),
    (r"^blocks\.(\d+)\.", r"encoder.layer.\1."),
    (r"\.attn\.proj\.", ".attention.o_proj."),
    (r"\.attn\.([qkv])\.", r".attention.\1_proj."),
    (r"\.ls([12])\.gamma$", r".layer_scale\1.lambda1"),
    (r"^norm\.", "layernorm."),
]  # the authors' names → those of transformers


def dinov2(size: str) -> Parts:
    """Return the parts for a key of SIZES. Raises ValueError if the package transformers is missing."""
    width = SIZES[size][0]
    return Parts(DinoV2(*SIZES[size]), BinsDepth(width), LinearClasses(width))


class Tokens(NamedTuple):
    """The last block's tokens as maps of patches [B,C,h,w]: raw, the class token beside each patch, and normalised."""

    patches: Tensor
    summary: Tensor
    normed: Tensor


class DinoV2(Backbone):
    """Image → tokens of its patches; sides are padded with zeros to multiples of 14, half on each side."""

    mean, std = IMAGENET_MEAN, IMAGENET_STD

    def __init__(self, width: int, layers: int, heads: int) -> None:
        super().__init__()
        try:
            from transformers import Dinov2Config, Dinov2Model
        except ImportError as error:
            raise ValueError("this backbone needs the package transformers: pip install '.[pretrained]'") from error
        config = Dinov2Config(
            hidden_size=width,
            num_hidden_layers=layers,
            num_attention_heads=heads,
            image_size=37 * PATCH,
            patch_size=PATCH,
        )
        self.vit = Dinov2Model(config)

    def forward(self, image: Tensor, rays: Tensor) -> Tokens:
        """Return the last block's tokens. Raises ValueError if the image is smaller than a patch."""
        size = image.shape[-2:]
        if min(size) < PATCH:
            raise ValueError(f"an image of {size[0]} x {size[1]} pixels is smaller than a patch of {PATCH} x {PATCH}")
        top, bottom, left, right = padding(size)
        padded = F.pad(image, (left, right, top, bottom))
        h, w = padded.shape[-2] // PATCH, padded.shape[-1] // PATCH
        states = self.vit(padded, output_hidden_states=True)
        raw, normed = states.hidden_states[-1], states.last_hidden_state  # [B,1+h·w,C], the class token first
        patches, summary = as_map(raw[:, 1:], h, w), raw[:, 0, :, None, None].expand(-1, -1, h, w)
        return Tokens(patches, summary, as_map(normed[:, 1:], h, w))

    def own_names(self, published: Mapping[str, Tensor]) -> dict[str, Tensor]:
        state: dict[str, Tensor] = {}
        for name, tensor in published.items():
            if ".attn.qkv." in name and tensor.shape[0] % 3 == 0:
                parts = {
                    name.replace(".qkv.", f".{part}."): third
                    for part, third in zip("qkv", tensor.chunk(3), strict=True)
                }
            else:
                parts = {name: tensor}
            state |= {f"vit.{renamed(part, NAMES)}": value for part, value in parts.items()}
        return state


class BinsDepth(Part):
    """The authors' linear depth head: how much each of 256 depths between 0.001 and 80 m counts."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.conv_depth = nn.Conv2d(2 * width, BINS, 1)

    def forward(self, tokens: Tokens, rays: Tensor) -> Tensor:
        """Return depth [B,H,W] in metres."""
        # The authors enlarge the tokens first; both are linear and weights of an interpolation add up to 1.
        logits = self.conv_depth(torch.cat([tokens.patches, tokens.summary], dim=1)).float()
        logits = F.interpolate(logits, scale_factor=4, mode="bilinear", align_corners=False)  # [B,256,4h,4w]
        shares = torch.relu(logits) + 0.1
        bins = torch.linspace(MIN_DEPTH_M, MAX_DEPTH_M, BINS, device=logits.device)
        with torch.autocast(logits.device.type, enabled=False):  # 256 halves would not add up
            depth = torch.einsum("bnhw,n->bhw", shares, bins) / shares.sum(dim=1)
        return unpadded(depth[:, None], rays)[:, 0]

    def own_names(self, published: Mapping[str, Tensor]) -> dict[str, Tensor]:
        return {name.removeprefix("decode_head."): tensor for name, tensor in published.items()}


class LinearClasses(Part):
    """The authors' linear segmentation head: ADE20K's 150 classes, gathered to Cityscapes' 19 and void."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.bn = nn.BatchNorm2d(width)
        self.conv_seg = nn.Conv2d(width, len(ADE20K), 1)

    def forward(self, tokens: Tokens, rays: Tensor) -> Tensor:
        """Return logits [B,20,H,W], the last one void."""
        return unpadded(to_cityscapes(self.conv_seg(self.bn(tokens.normed))), rays)

    def own_names(self, published: Mapping[str, Tensor]) -> dict[str, Tensor]:
        return {name.removeprefix("decode_head."): tensor for name, tensor in published.items()}


def padding(size: torch.Size) -> tuple[int, int, int, int]:
    """Return the rows above and below and the columns left and right that make sides (H, W) multiples of 14."""
    rows, columns = (-size[0]) % PATCH, (-size[1]) % PATCH
    return rows // 2, rows - rows // 2, columns // 2, columns - columns // 2


def unpadded(x: Tensor, rays: Tensor) -> Tensor:
    """Enlarge a map [B,C,h,w] of the padded image and cut the image [B,C,H,W] out of it.

    The authors' code stretches the padded map over the image instead, which shifts it by up to half the padding.
    """
    height, width = rays.shape[-2:]
    top, bottom, left, right = padding(rays.shape[-2:])
    size = (top + height + bottom, left + width + right)
    whole = F.interpolate(x, size, mode="bilinear", align_corners=False)
    return whole[..., top : top + height, left : left + width]


def as_map(tokens: Tensor, h: int, w: int) -> Tensor:
    """Tokens [B,h·w,C] as a map [B,C,h,w]."""
    return tokens.transpose(1, 2).reshape(*tokens.shape[::2], h, w)
