"""Section ``town``: the embedded sample."""

from typing import Annotated

from pydantic import Field

from pipeline.params import Count, ImageSize, Section


class Frames(Section):
    """Frames per drive of each split."""

    train: Count
    val: Count
    test: Count


class Town(Section):
    key = "town"
    seed: int
    image_size: ImageSize
    frames: Frames
    scan_rays: Annotated[tuple[int, int], Field(description="[rings, rays per ring] of the LiDAR")]
