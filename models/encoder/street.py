"""The encoder of real streets: depth of RT-MonoDepth-S and classes of EfficientViT-Seg-B0.

The weights of both are as published.
"""

import math
from pathlib import Path

import torch
from torch import Tensor, nn

from models.encoder.efficientvit import STRIDE, EfficientViT
from models.encoder.heads import resize_map
from models.encoder.rtmonodepth_s import RTMonoDepthS

# Factor by which the sides of an image are enlarged before it is classified. Small images have too
# few pixels for a stride of 32.
ENLARGED = 1.5
# URL of the folder with the published files of RT-MonoDepth-S.
_RTMONODEPTH = "https://github.com/Ashwani564/RT-Monodepth-Construction/raw/d9a171f0a98b4c7ccd4713197af5e26689b0adfb/weights/RTMonoDepth/s/ms_640_192/"
# Terms of use of RT-MonoDepth-S.
_MONODEPTH2 = "Monodepth2's terms: non-commercial use only"
# Path of a published file below weights/ → its URL, SHA-256 and terms of use.
SOURCES = {
    "rtmonodepth-s/encoder.pth": (
        _RTMONODEPTH + "encoder.pth",
        "6cdff9dfd76b0b804a6954508ebc57fbd8ff4713642282e861d47d9939190917",
        _MONODEPTH2,
    ),
    "rtmonodepth-s/depth.pth": (
        _RTMONODEPTH + "depth.pth",
        "6e0267e403190269cc67b89cd6da8c0819d179fd0fa77f6082ba51a1593aaffc",
        _MONODEPTH2,
    ),
    "efficientvit_b0/b0.pt": (
        "https://github.com/Earth2Adam/EfficientViTSeg/raw/2c435b6eb93f43cafa8724af6f2adf79faa4726a/ckpts/b0.pt",
        "923d6fdd5e93640cc0c2f3f213764f34e80b477cd98a6b294d870ea6df5acc50",
        "Apache-2.0; Cityscapes' terms: non-commercial use only",
    ),
}


class Street(nn.Module):
    """Two published networks, for depth and for classes.

    Image [B,3,H,W] and intrinsics [B,3,3] → depth [B,H,W] in metres and logits [B,19,H,W].
    """

    def __init__(self) -> None:
        super().__init__()
        self.depth = RTMonoDepthS()
        self.classes = EfficientViT()

    def forward(self, image: Tensor, K: Tensor) -> tuple[Tensor, Tensor]:
        rgb = image.float() / 255
        size = image.shape[-2:]
        enlarged = resize_map(rgb, [STRIDE * math.ceil(ENLARGED * side / STRIDE) for side in size])
        return self.depth(rgb, K), resize_map(self.classes(enlarged), size)

    def load_published(self, folder: Path) -> None:
        """Load the files of SOURCES below a folder."""
        files = [folder / path for path in SOURCES]
        contents = [torch.load(file, weights_only=True, map_location="cpu") for file in files]
        encoder, decoder, classes = contents
        tensors = {name: x for name, x in encoder.items() if isinstance(x, Tensor)}
        self.depth.encoder.load_state_dict(tensors)

        # The heads for depth at 1/2 and 1/4 of the image are left out. Only training used them.
        coarser = ("decoder.9.", "decoder.10.")
        tensors = {name: x for name, x in decoder.items() if not name.startswith(coarser)}
        self.depth.decoder.load_state_dict(tensors)
        self.classes.load_state_dict(classes["state_dict"])
