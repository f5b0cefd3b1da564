"""Section ``sample``: the embedded sample."""

from typing import Annotated, Literal

from pydantic import Field

from pipeline.base.params import Count, ImageSize, Section, Seed


class Sample(Section):
    seed: Seed
    image_size: ImageSize
    # Frames per drive of each split.
    frames: Annotated[dict[Literal["train", "val", "test"], Count], Field(min_length=3)]
    # LiDAR rings, and rays per ring.
    scan_rays: Annotated[tuple[Count, Count], Field(strict=False)]
