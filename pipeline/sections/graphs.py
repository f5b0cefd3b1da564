"""Section ``graphs``: what the networks eat, one entry per variant."""

from typing import Annotated, Literal

from pydantic import Field

from pipeline.params import Count, Fraction, Section


class Variant(Section):
    """One entry of ``graphs``: what a network eats."""

    cloud: Literal["pseudo", "lidar"]
    points: Count
    k: Annotated[int, Field(ge=1, le=32)]
    keep_inter_class: Fraction = 1.0
    seed: int = 0
