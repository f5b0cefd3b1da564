"""Swin-T (Liu et al. 2021), the paper's backbone, with a pyramid decoder for each head.

The backbone is Hugging Face's SwinModel; its weights are ``pytorch_model.bin`` of a published Swin-T with patch 4 and
window 7. Both decoders are fitted, as none are published.
"""

from collections.abc import Mapping, Sequence

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from models.encoder.backbones import IMAGENET_MEAN, IMAGENET_STD, Backbone, Part, Parts, renamed, transformers
from models.encoder.heads import CellClasses, CellDepth

PATCH = 4
EMBED, DEPTHS, HEADS, WINDOW = 96, (2, 2, 6, 2), (3, 6, 12, 24), 7
CHANNELS = tuple(EMBED * 2**level for level in range(4))  # at 1/4, 1/8, 1/16 and 1/32 of the image
DECODED = 64

NAMES = [
    (r"\.attention\.self\.([qkv])(uery|ey|alue)\.", r".attention.\1_proj."),
    (r"\.attention\.self\.(relative_position_bias)_table$", r".attention.\1.\1_table"),
    (r"\.attention\.output\.dense\.", ".attention.o_proj."),
    (r"\.intermediate\.dense\.", ".mlp.fc1."),
    (r"\.output\.dense\.", ".mlp.fc2."),
]  # names of published files → those of transformers 5, which renames only in from_pretrained


def swin() -> Parts:
    """Return the parts. Raises ValueError if the package transformers is missing."""
    return Parts(Swin(), PyramidHead(CellDepth(DECODED, PATCH)), PyramidHead(CellClasses(DECODED, PATCH)))


class Swin(Backbone):
    """Image → maps at 1/4, 1/8, 1/16 and 1/32 of its size."""

    mean, std = IMAGENET_MEAN, IMAGENET_STD

    def __init__(self) -> None:
        super().__init__()
        library = transformers()
        # No drop path: a resumed fit must have the same weights.
        config = library.SwinConfig(
            patch_size=PATCH, embed_dim=EMBED, depths=DEPTHS, num_heads=HEADS, window_size=WINDOW, drop_path_rate=0.0
        )
        self.swin = library.SwinModel(config, add_pooling_layer=False)

    def forward(self, image: Tensor, rays: Tensor) -> list[Tensor]:
        """Return maps [B,96·2^l,ceil(H/2^(l+2)),ceil(W/2^(l+2))]."""
        # always_partition: otherwise the library shrinks windows on small maps, and position biases have other shapes.
        states = self.swin(
            image, output_hidden_states=True, output_hidden_states_before_downsampling=True, always_partition=True
        )
        return list(states.reshaped_hidden_states[1:])

    def convert_names(self, published: Mapping[str, Tensor]) -> dict[str, Tensor]:
        return {
            renamed(name, NAMES): tensor
            for name, tensor in published.items()
            # The index follows from the window's size; transformers 5 does not store it.
            if not name.startswith("classifier.") and not name.endswith(".relative_position_index")
        }


class PyramidHead(Part):
    """Feature pyramid (Lin et al. 2017) from coarse to fine maps, then a head at 1/4."""

    def __init__(self, head: Part) -> None:
        super().__init__()
        self.sides = nn.ModuleList(nn.Conv2d(channels, DECODED, 1) for channels in CHANNELS)
        self.smooth = nn.Sequential(
            nn.Conv2d(DECODED + 2, DECODED, 3, padding=1),
            nn.ReLU(),
            nn.Conv2d(DECODED, DECODED, 3, padding=1),
            nn.ReLU(),
        )
        self.head = head

    def forward(self, maps: Sequence[Tensor], rays: Tensor) -> Tensor:
        """Return the head's output for maps of :class:`Swin` and rays [B,2,H,W]."""
        y = self.sides[-1](maps[-1])
        for side, finer in zip(reversed(self.sides[:-1]), reversed(maps[:-1]), strict=True):
            y = side(finer) + F.interpolate(y, finer.shape[-2:], mode="bilinear", align_corners=False)
        slopes = F.interpolate(rays, y.shape[-2:], mode="bilinear", align_corners=False, antialias=True)
        result: Tensor = self.head(self.smooth(torch.cat([y, slopes], dim=1)), rays)
        return result
