"""Section ``evaluate``: how the intervals of a model's errors are computed."""

from typing import Annotated

from pydantic import Field

from pipeline.base.params import Count, Section, Seed


class Evaluate(Section):
    # Number of draws of the bootstrap.
    bootstrap_samples: Annotated[int, Field(ge=1, le=100_000)]
    # Least number of frames of the parts into which a long drive is cut.
    bootstrap_block_frames: Count
    # Seed of the draws.
    seed: Seed
