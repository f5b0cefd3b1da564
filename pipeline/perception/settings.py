"""Section ``perception``: depth and classes by the unified encoder."""

from typing import Annotated, Literal

from pydantic import Field

from pipeline.base.params import Count, Section


class Perception(Section):
    batch: Count
    # Largest depth of traffic, as a multiple of the depth of the ground at its lower edge.
    reach: Annotated[float, Field(ge=1)] | None = None
    precision: Literal["auto", "float32"] = "auto"
