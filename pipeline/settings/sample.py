"""Section ``sample``: the embedded sample."""

from typing import Annotated

from pydantic import Field

from pipeline.base.params import Count, ImageSize, Section, Seed


class Frames(Section):
    """Frames per drive of each split."""

    train: Count
    val: Count
    test: Count


class Sample(Section):
    key = "sample"
    seed: Seed
    image_size: ImageSize
    frames: Frames
    scan_rays: Annotated[tuple[Count, Count], Field(strict=False)]
