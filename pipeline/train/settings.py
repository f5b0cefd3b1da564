"""Section ``train``: fitting a model."""

from typing import Annotated

from pydantic import Field

from pipeline.base.params import Count, Positive, Rate, Section, Seed


class Train(Section):
    epochs: Count
    patience: Count
    seeds: list[Seed] = Field(min_length=1)
    learning_rate: Rate
    weight_decay: Annotated[float, Field(ge=0, le=100)]
    clip_norm: Positive
    span_windows: Count
    batch_spans: Count
    rescale: Annotated[float, Field(ge=1, le=2)]
    average: Annotated[float, Field(ge=0, lt=1)]
