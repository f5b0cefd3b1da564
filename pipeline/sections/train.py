"""Section ``train``: fitting a model."""

from typing import Annotated, Literal

from pydantic import Field, field_validator

from pipeline.base.params import Count, Fraction, Positive, Rate, Section, Seed


class Noise(Section):
    """Simulated perception errors, in training only, drawn per run of consecutive frames. 0 switches one off."""

    depth_scale: Annotated[float, Field(ge=0, le=1, description="relative error of depth")] = 0.0
    depth_waves: Annotated[
        float, Field(ge=0, le=0.5, description="relative error of depth that varies over the view in waves")
    ] = 0.0
    speed: Annotated[float, Field(ge=0, le=1, description="relative error of measured speed")] = 0.0
    confused: Annotated[Fraction, Field(description="probability that part of a class becomes a similar class")] = 0.0
    missing: Annotated[Fraction, Field(description="probability that a class becomes void")] = 0.0
    dropped: Annotated[float, Field(ge=0, lt=1, description="maximum share of a frame's points to remove")] = 0.0
    hidden_deg: Annotated[float, Field(ge=0, le=90, description="maximum width of a sector without points")] = 0.0


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
    mirror: Annotated[bool, Field(description="train each run of frames together with its mirror image in one step")]
    rescale: Annotated[float, Field(ge=1, le=2)]
    noise: Noise
    average: Annotated[float, Field(ge=0, lt=1)]
    keep: Literal["last", "smoothed", "best"]
    precision: Literal["auto", "bfloat16", "float32", "float64"]

    @field_validator("seeds")
    @classmethod
    def _distinct(cls, seeds: list[Seed]) -> list[int]:
        if len(set(seeds)) < len(seeds):
            raise ValueError("a seed is named twice")
        return seeds
