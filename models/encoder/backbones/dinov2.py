"""DINOv2 (Oquab et al. 2023) with its authors' linear heads: KITTI depth in metres and ADE20K classes.

The backbone is Hugging Face's Dinov2Model with the authors' own files as weights:
``dinov2_vits14_pretrain.pth``, ``dinov2_vits14_kitti_linear_head.pth``, ``dinov2_vits14_ade20k_linear_head.pth``.
"""

from collections.abc import Mapping
from typing import NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from models.encoder.backbones import IMAGENET_MEAN, IMAGENET_STD, Backbone, Part, Parts, renamed, transformers

ADE20K = (
    "wall", "building", "sky", "floor", "tree", "ceiling", "road", "bed", "windowpane", "grass", "cabinet", "sidewalk",
    "person", "earth", "door", "table", "mountain", "plant", "curtain", "chair", "car", "water", "painting", "sofa",
    "shelf", "house", "sea", "mirror", "rug", "field", "armchair", "seat", "fence", "desk", "rock", "wardrobe", "lamp",
    "bathtub", "railing", "cushion", "base", "box", "column", "signboard", "chest of drawers", "counter", "sand",
    "sink", "skyscraper", "fireplace", "refrigerator", "grandstand", "path", "stairs", "runway", "case", "pool table",
    "pillow", "screen door", "stairway", "river", "bridge", "bookcase", "blind", "coffee table", "toilet", "flower",
    "book", "hill", "bench", "countertop", "stove", "palm", "kitchen island", "computer", "swivel chair", "boat",
    "bar", "arcade machine", "hovel", "bus", "towel", "light", "truck", "tower", "chandelier", "awning", "streetlight",
    "booth", "television", "airplane", "dirt track", "apparel", "pole", "land", "bannister", "escalator", "ottoman",
    "bottle", "buffet", "poster", "stage", "van", "ship", "fountain", "conveyer belt", "canopy", "washer", "plaything",
    "swimming pool", "stool", "barrel", "basket", "waterfall", "tent", "bag", "minibike", "cradle", "oven", "ball",
    "food", "step", "tank", "trade name", "microwave", "pot", "animal", "bicycle", "lake", "dishwasher", "screen",
    "blanket", "sculpture", "hood", "sconce", "vase", "traffic light", "tray", "ashcan", "fan", "pier", "crt screen",
    "plate", "monitor", "bulletin board", "shower", "radiator", "glass", "clock", "flag",
)  # fmt: skip

# Cityscapes classes in the order of their trainIds. ADE20K has no class for rider and train. All classes that are not
# listed are void, bridges among them, as in Cityscapes.
CITYSCAPES = {
    "road": "road, runway, dirt track",
    "sidewalk": "sidewalk, path, floor",
    "building": "building, house, skyscraper, tower, hovel, booth, grandstand, awning, canopy, windowpane, door, "
    "screen door, blind, column, stairs, stairway, step, trade name",
    "wall": "wall",
    "fence": "fence, railing, bannister",
    "pole": "pole, streetlight",
    "traffic light": "traffic light",
    "traffic sign": "signboard",
    "vegetation": "tree, plant, palm, flower",
    "terrain": "grass, earth, field, land, sand, rock, hill, mountain",
    "sky": "sky",
    "person": "person",
    "rider": "",
    "car": "car, van",
    "truck": "truck",
    "bus": "bus",
    "train": "",
    "motorcycle": "minibike",
    "bicycle": "bicycle",
}
_GROUPS = [sorted(ADE20K.index(name) for name in names.split(", ") if name) for names in CITYSCAPES.values()]
GROUPS = [*_GROUPS, sorted({*range(len(ADE20K))}.difference(*_GROUPS))]
"""Numbers of ADE20K's classes for each of Cityscapes' classes, and for void."""
MARGIN = 10.0  # of a class without members, below the least likely other


def to_cityscapes(logits: Tensor) -> Tensor:
    """Map logits [B,150,H,W] of ADE20K to logits [B,20,H,W] of Cityscapes' classes and void.

    A class has the summed probability of its members. A class without members is below all others, so that it is never
    predicted, also between interpolated pixels, and has a finite loss as a target.
    """
    planes = logits.unbind(1)  # an index from a list would be a blocking copy to a GPU for each class
    gathered = {
        target: torch.stack([planes[member] for member in group], dim=1).logsumexp(1)
        for target, group in enumerate(GROUPS)
        if group
    }
    # Without gradients, which would train the least likely class.
    never = torch.stack(list(gathered.values())).amin(dim=0).detach() - MARGIN
    return torch.stack([gathered.get(target, never) for target in range(len(GROUPS))], dim=1)


PATCH = 14
SIZES = {"vits14": (384, 12, 6), "vitb14": (768, 12, 12), "vitl14": (1024, 24, 16)}  # width, layers, attention heads
MIN_DEPTH_M, MAX_DEPTH_M, BINS = 0.001, 80.0, 256  # of the KITTI heads; the authors' hub code has NYU's maximum of 10 m

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
    """Tokens of the last block as maps [B,C,h,w]: raw patches, the class token for each patch, normalised patches."""

    patches: Tensor
    summary: Tensor
    normed: Tensor


class DinoV2(Backbone):
    """Image → tokens of its patches. Zeros pad the image to multiples of 14, half on each side."""

    mean, std = IMAGENET_MEAN, IMAGENET_STD

    def __init__(self, width: int, layers: int, heads: int) -> None:
        super().__init__()
        library = transformers()
        config = library.Dinov2Config(
            hidden_size=width,
            num_hidden_layers=layers,
            num_attention_heads=heads,
            image_size=37 * PATCH,
            patch_size=PATCH,
        )
        self.vit = library.Dinov2Model(config)

    def forward(self, image: Tensor, rays: Tensor) -> Tokens:
        """Return the last block's tokens. Raises ValueError if the image is smaller than a patch."""
        size = image.shape[-2:]
        if min(size) < PATCH:
            raise ValueError(f"image of {size[0]} x {size[1]} pixels, expected at least {PATCH} x {PATCH}")
        top, bottom, left, right = padding(size)
        padded = F.pad(image, (left, right, top, bottom))
        h, w = padded.shape[-2] // PATCH, padded.shape[-1] // PATCH
        states = self.vit(padded, output_hidden_states=True)
        raw, normed = states.hidden_states[-1], states.last_hidden_state  # [B,1+h·w,C], the class token first
        patches, summary = as_map(raw[:, 1:], h, w), raw[:, 0, :, None, None].expand(-1, -1, h, w)
        return Tokens(patches, summary, as_map(normed[:, 1:], h, w))

    def convert_names(self, published: Mapping[str, Tensor]) -> dict[str, Tensor]:
        state: dict[str, Tensor] = {}
        for name, tensor in published.items():
            qkv = ".attn.qkv." in name and tensor.shape[0] % 3 == 0
            thirds = zip("qkv", tensor.chunk(3), strict=True) if qkv else [("qkv", tensor)]
            for part, third in thirds:
                state[f"vit.{renamed(name.replace('.qkv.', f'.{part}.'), NAMES)}"] = third
        return state


class AuthorsHead(Part):
    """A head with the authors' names of tensors."""

    def convert_names(self, published: Mapping[str, Tensor]) -> dict[str, Tensor]:
        return {name.removeprefix("decode_head."): tensor for name, tensor in published.items()}


class BinsDepth(AuthorsHead):
    """The authors' linear depth head: a weighted mean of 256 depths between 0.001 and 80 m."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.conv_depth = nn.Conv2d(2 * width, BINS, 1)

    def forward(self, tokens: Tokens, rays: Tensor) -> Tensor:
        """Return depth [B,H,W] in metres."""
        # The authors interpolate the tokens first; both steps are linear, and weights of an interpolation add up to 1.
        logits = self.conv_depth(torch.cat([tokens.patches, tokens.summary], dim=1)).float()
        logits = F.interpolate(logits, scale_factor=4, mode="bilinear", align_corners=False)  # [B,256,4h,4w]
        shares = torch.relu(logits) + 0.1
        bins = torch.linspace(MIN_DEPTH_M, MAX_DEPTH_M, BINS, device=logits.device)
        with torch.autocast(logits.device.type, enabled=False):  # a sum of 256 terms is inaccurate in half precision
            depth = torch.einsum("bnhw,n->bhw", shares, bins) / shares.sum(dim=1)
        return unpadded(depth[:, None], rays)[:, 0]


class LinearClasses(AuthorsHead):
    """The authors' linear segmentation head: ADE20K's 150 classes, mapped to Cityscapes' 19 and void."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.bn = nn.BatchNorm2d(width)
        self.conv_seg = nn.Conv2d(width, len(ADE20K), 1)

    def forward(self, tokens: Tokens, rays: Tensor) -> Tensor:
        """Return logits [B,20,H,W], void last."""
        return unpadded(to_cityscapes(self.conv_seg(self.bn(tokens.normed))), rays)


def padding(size: torch.Size) -> tuple[int, int, int, int]:
    """Return the padding (top, bottom, left, right) of an image (H, W) to multiples of 14."""
    rows, columns = (-size[0]) % PATCH, (-size[1]) % PATCH
    return rows // 2, rows - rows // 2, columns // 2, columns - columns // 2


def unpadded(x: Tensor, rays: Tensor) -> Tensor:
    """Interpolate a map [B,C,h,w] to the padded image and crop it to the image, [B,C,H,W].

    The authors' code interpolates the map to the unpadded image, which shifts it by up to half the padding.
    """
    height, width = rays.shape[-2:]
    top, bottom, left, right = padding(rays.shape[-2:])
    size = (top + height + bottom, left + width + right)
    padded = F.interpolate(x, size, mode="bilinear", align_corners=False)
    return padded[..., top : top + height, left : left + width]


def as_map(tokens: Tensor, h: int, w: int) -> Tensor:
    """Reshape tokens [B,h·w,C] to a map [B,C,h,w]."""
    return tokens.transpose(1, 2).reshape(*tokens.shape[::2], h, w)
