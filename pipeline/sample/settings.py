"""Section ``sample``: the rendered streets of dataset sample."""

from typing import Literal

from pydantic import Field

from pipeline.base.params import Count, ImageSize, Section, Seed


class Sample(Section):
    seed: Seed = Field(description="seed of the streets, and of what happens in them")
    image_size: ImageSize = Field(
        description="[height, width] of the rendered images in pixels. Images larger than those of "
        "`ingest.image_size` are averaged, which smooths edges"
    )
    frames: dict[Literal["train", "val", "test"], Count] = Field(
        min_length=3, description="frames of each drive of a split, at 10 Hz"
    )
    scan_rays: tuple[Count, Count] = Field(
        strict=False,
        description="[rings, rays per ring] of the LiDAR, which `ingest.lidar` turns on. The "
        "HDL-64E has [64, 2000]",
    )
