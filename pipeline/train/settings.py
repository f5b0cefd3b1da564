"""Section ``train``: fitting a model."""

from typing import Annotated

from pydantic import Field, field_validator

from pipeline.base.params import Count, Positive, Rate, Section, Seed


class Train(Section):
    # Largest number of epochs.
    epochs: Count
    # Number of epochs without a better validation error after which training stops.
    patience: Count
    # A model has a network for each seed.
    seeds: list[Seed] = Field(min_length=1)
    # Largest learning rate; it rises at first, then falls.
    learning_rate: Rate
    # Weight decay of AdamW, for matrices only.
    weight_decay: Annotated[float, Field(ge=0, le=100)]
    # Largest norm of the gradient; a larger gradient is scaled to it.
    clip_norm: Positive
    # Number of consecutive windows in a span, which share the embeddings of their frames.
    span_windows: Count
    # Number of spans in an optimiser step.
    batch_spans: Count
    # Largest random factor by which the scene of a span, and its bends, are scaled; 1: off.
    rescale: Annotated[float, Field(ge=1, le=2)]
    # Decay of the moving average of the weights, per step; 0: off.
    average: Annotated[float, Field(ge=0, lt=1)]

    @field_validator("seeds")
    @classmethod
    def _check_different(cls, seeds: list[int]) -> list[int]:
        if len(set(seeds)) < len(seeds):
            raise ValueError("expected each seed once")
        return seeds
