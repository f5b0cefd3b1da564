"""Section ``evaluate``: judging a model."""

from typing import Literal

from pydantic import Field, field_validator

from pipeline.base.params import Count, Positive, Section, Seed


class Evaluate(Section):
    key = "evaluate"
    bootstrap_samples: Count
    bootstrap_block_frames: Count
    curvature_bins_1pm: list[Positive] = Field(min_length=1, description="edges between the bins of |curvature|")
    path: Literal["bicycle", "paper"] = Field(description="what a path is integrated by, see pipeline/label.py")
    seed: Seed

    @field_validator("curvature_bins_1pm")
    @classmethod
    def _ascending(cls, edges: list[float]) -> list[float]:
        if sorted(set(edges)) != edges:
            raise ValueError("the edges between bins must ascend")
        return edges
