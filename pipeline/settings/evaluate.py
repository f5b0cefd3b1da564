"""Section ``evaluate``: how errors of a model are computed."""

from typing import Annotated

from pydantic import Field

from pipeline.base.params import Count, Positive, Section, Seed


class Evaluate(Section):
    bootstrap_samples: Annotated[int, Field(ge=1, le=100_000)]
    bootstrap_block_frames: Count
    curvature_bins_1pm: list[Positive] = Field(min_length=1, description="edges between the bins of |curvature|")
    seed: Seed
