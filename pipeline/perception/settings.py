"""Section ``perception``: depth and classes by the unified encoder."""

from typing import Literal

from pydantic import Field

from pipeline.base.params import Count, Section


class Perception(Section):
    batch: Count = Field(
        description="images in a forward pass. A GPU takes 32 or more, a CPU one by one"
    )
    precision: Literal["auto", "float32"] = Field(
        default="auto",
        description="precision of matrix products. `auto` is bfloat16 on a GPU that supports it, "
        "else float32",
    )
