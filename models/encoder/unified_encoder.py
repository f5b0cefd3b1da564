"""Encoders: networks of metric depth and Cityscapes classes of an image (paper §3.2).

An encoder is a module ``forward(image, K) -> (depth, logits)``:

- image: RGB uint8 [B,3,H,W].
- K: pinhole intrinsics [B,3,3] at this image size.
- depth: [B,H,W], metres along the optical axis.
- logits: of Cityscapes' classes, [B,19,H,W], or [B,20,H,W] with void last.
"""

from collections.abc import Callable, Mapping
from typing import Any

from torch import nn

from models.encoder.hugging_face import HuggingFace, Pair
from models.encoder.small import Small
from models.encoder.street import Street
from pipeline.base.errors import InputError

# JSON-able description of an encoder, complete without a hub; ``backbone`` is a key of BUILD.
Architecture = Mapping[str, Any]
# Backbone → how its network is built from a description.
BUILD: dict[str, Callable[[Architecture], nn.Module]] = {
    "small": lambda architecture: Small(),
    "street": lambda architecture: Street(),
    "pair": Pair,
    "hugging_face": HuggingFace,
    "precomputed": lambda architecture: nn.Module(),  # files instead of a network
}


def build(architecture: Architecture) -> nn.Module:
    """Return the described encoder, with random weights.

    Raises InputError for an unknown backbone or a missing package.
    """
    backbone = architecture["backbone"]
    if backbone not in BUILD:
        raise InputError(f"unknown backbone {backbone!r} (known: {', '.join(BUILD)})")
    return BUILD[backbone](architecture)
