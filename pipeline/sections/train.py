"""Section ``train``: fitting a model."""

from typing import Annotated, Literal

from pydantic import Field, field_validator

from pipeline.base.params import Count, Fraction, Positive, Rate, Section, Seed


class Noise(Section):
    """What perception gets wrong, in training only; each 0 is off. Drawn once for each run of consecutive frames."""

    depth_scale: Annotated[float, Field(ge=0, le=1, description="share by which depth is too large or small")] = 0.0
    depth_waves: Annotated[
        float, Field(ge=0, le=0.5, description="share by which it is so here and there, in waves over the view")
    ] = 0.0
    speed: Annotated[float, Field(ge=0, le=1, description="share by which measured speed is too large or small")] = 0.0
    confused: Annotated[Fraction, Field(description="of each class, that part of it is taken for a similar one")] = 0.0
    missing: Annotated[Fraction, Field(description="of each class, that it is not seen")] = 0.0
    dropped: Annotated[float, Field(ge=0, lt=1, description="share of a frame's points, at most")] = 0.0
    hidden_deg: Annotated[float, Field(ge=0, le=90, description="width of a sector without points, at most")] = 0.0


class Train(Section):
    key = "train"
    epochs: Count
    patience: Count
    seeds: list[Seed] = Field(min_length=1)
    learning_rate: Rate
    weight_decay: Annotated[float, Field(ge=0, le=100)]
    clip_norm: Positive
    run_windows: Count
    batch_runs: Count
    mirror: bool
    rescale: Annotated[float, Field(ge=1, le=2)]
    noise: Noise
    average: Annotated[float, Field(ge=0, lt=1)]
    keep: Literal["last", "smoothed", "best"]
    precision: Literal["auto", "bfloat16", "float32", "float64"]

    @field_validator("seeds")
    @classmethod
    def _distinct(cls, seeds: list[Seed]) -> list[int]:
        if len(set(seeds)) < len(seeds):
            raise ValueError("a seed is named twice: each adds a training run, so name it once")
        return seeds
