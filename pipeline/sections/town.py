"""Section ``town``: the embedded sample."""

from typing import Annotated

from pydantic import Field

from pipeline.base.params import Count, ImageSize, Section, Seed


class Frames(Section):
    """Frames per drive of each split; of a replayed drive at most so many, its first ones."""

    train: Count
    val: Count
    test: Count


class Town(Section):
    key = "town"
    seed: Seed
    image_size: ImageSize
    replay: Annotated[str, Field(min_length=1)] | None = None
    frames: Frames
    scan_rays: Annotated[tuple[Count, Count], Field(description="[rings, rays per ring] of the LiDAR")]
