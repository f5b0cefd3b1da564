"""Section ``evaluate``: how errors of a model are computed."""

from typing import Annotated

from pydantic import Field

from pipeline.base.params import Count, Section, Seed


class Evaluate(Section):
    bootstrap_samples: Annotated[int, Field(ge=1, le=100_000)]
    bootstrap_block_frames: Count
    seed: Seed
