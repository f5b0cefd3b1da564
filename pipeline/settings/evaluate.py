"""Section ``evaluate``: how errors of a model are computed."""

from typing import Annotated, Literal

from pydantic import Field, field_validator

from pipeline.base.params import Count, Positive, Section, Seed


class Evaluate(Section):
    key = "evaluate"
    bootstrap_samples: Annotated[int, Field(ge=1, le=100_000)]
    bootstrap_block_frames: Count
    curvature_bins_1pm: list[Positive] = Field(min_length=1, description="edges between the bins of |curvature|")
    path: Literal["bicycle", "paper"] = Field(
        description="formula that integrates a path, see pipeline/labels/label.py"
    )
    seed: Seed

    @field_validator("curvature_bins_1pm")
    @classmethod
    def _check_ascending(cls, edges: list[float]) -> list[float]:
        if sorted(set(edges)) != edges:
            raise ValueError("expected ascending edges between bins")
        return edges
