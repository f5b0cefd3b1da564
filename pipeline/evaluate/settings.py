"""Section ``evaluate``: how the intervals of a model's errors are computed."""

from typing import Annotated

from pydantic import Field

from pipeline.base.params import Count, Section, Seed


class Evaluate(Section):
    # Number of draws of the bootstrap.
    bootstrap_samples: Annotated[int, Field(ge=1, le=100_000)]
    # A long drive is cut into parts, which have at least this number of frames each.
    bootstrap_block_frames: Count
    # Seed of the draws.
    seed: Seed
