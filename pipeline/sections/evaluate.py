"""Section ``evaluate``: judging a model."""

from pydantic import Field

from pipeline.params import Count, Positive, Section


class Evaluate(Section):
    key = "evaluate"
    bootstrap_samples: Count
    bootstrap_block_frames: Count
    curvature_bins_1pm: list[Positive] = Field(min_length=1, description="edges between the bins of |curvature|")
    seed: int
