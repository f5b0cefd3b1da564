"""Section ``encoder``: how the unified encoder comes to its weights."""

from typing import Annotated

from pydantic import Field

from pipeline.params import Count, Positive, Section


class Encoder(Section):
    key = "encoder"
    backbone: str
    weights: str | None
    frozen: Annotated[bool, Field(description="keep the backbone as it is and fit the heads alone")] = False
    epochs: Annotated[int, Field(ge=0)]
    frames: Count
    batch: Count
    learning_rate: Positive
    seed: int
