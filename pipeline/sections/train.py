"""Section ``train``: fitting a model."""

from typing import Annotated, Literal

from pydantic import Field, field_validator

from pipeline.base.params import Count, Positive, Section, Seed


class Train(Section):
    key = "train"
    epochs: Count
    patience: Count
    seeds: list[Seed] = Field(min_length=1)
    learning_rate: Positive
    weight_decay: Annotated[float, Field(ge=0)]
    clip_norm: Positive
    run_windows: Count
    batch_runs: Count
    mirror: bool
    rescale: Annotated[float, Field(ge=1, le=2)]
    average: Annotated[float, Field(ge=0, lt=1)]
    precision: Literal["auto", "bfloat16", "float32", "float64"]

    @field_validator("seeds")
    @classmethod
    def _distinct(cls, seeds: list[Seed]) -> list[int]:
        if len(set(seeds)) < len(seeds):
            raise ValueError("a seed is named twice: each adds a training run, so name it once")
        return seeds
