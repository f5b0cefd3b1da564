"""Section ``perception``: depth and classes by the unified encoder."""

from typing import Literal

from pipeline.base.params import Count, Section


class Perception(Section):
    # Number of images in a forward pass. On a GPU, it may be larger.
    batch: Count
    # Precision of products: float32, or auto for bfloat16 on a GPU that supports it.
    precision: Literal["auto", "float32"] = "auto"
