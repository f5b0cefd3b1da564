"""Section ``sample``: the rendered streets of dataset sample."""

from typing import Annotated, Literal

from pydantic import Field

from pipeline.base.params import Count, ImageSize, Section, Seed


class Sample(Section):
    seed: Seed
    # Height and width of the rendered images in pixels.
    image_size: ImageSize
    # Split → number of frames in each of its drives.
    frames: Annotated[dict[Literal["train", "val", "test"], Count], Field(min_length=3)]
    # Number of rings of the LiDAR, and number of rays per ring.
    scan_rays: Annotated[tuple[Count, Count], Field(strict=False)]
