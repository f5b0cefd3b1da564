"""Unified encoders: networks for both metric depth and Cityscapes classes (paper §3.2).

An encoder is a module ``forward(image, K) -> (depth, logits)``:

- image: RGB uint8 [B,3,H,W].
- K: pinhole intrinsics [B,3,3] at this image size.
- depth: [B,H,W], metres along the optical axis.
- logits: [B,19,H,W] for Cityscapes' classes.
"""

from collections.abc import Callable, Mapping
from typing import Any

from torch import nn

from models.encoder.hugging_face import HuggingFace, Pair
from models.encoder.small import Small
from models.encoder.street import Street
from pipeline.base.errors import InputError

# Description of an encoder, which can be written as JSON. Its ``backbone`` is a key of BUILD. The
# network can be built from it without access to Hugging Face's hub.
Architecture = Mapping[str, Any]
# Backbone → function that builds its network from a description.
BUILD: dict[str, Callable[[Architecture], nn.Module]] = {
    "small": lambda architecture: Small(),
    "street": lambda architecture: Street(),
    "pair": Pair,
    "hugging_face": HuggingFace,
    # Depth and classes are read from files, so this network is never called.
    "precomputed": lambda architecture: nn.Module(),
}


def build_network(architecture: Architecture) -> nn.Module:
    """Return the described encoder, with random weights.

    Raises InputError for an unknown backbone or a missing package.
    """
    backbone = architecture["backbone"]
    if backbone not in BUILD:
        raise InputError(f"unknown backbone {backbone!r} (known: {', '.join(BUILD)})")
    return BUILD[backbone](architecture)
