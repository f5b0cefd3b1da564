"""Section ``perception``: depth and classes by the unified encoder."""

from typing import Annotated, Literal

from pydantic import Field

from pipeline.base.params import Count, Section


class Perception(Section):
    # Number of images in a forward pass. On a GPU, it may be larger.
    batch: Count
    # Largest depth of traffic, as a multiple of the depth of flat ground at its lower edge.
    reach: Annotated[float, Field(ge=1)] | None = None
    # Precision of products: float32, or auto for bfloat16 on a GPU that supports it.
    precision: Literal["auto", "float32"] = "auto"
