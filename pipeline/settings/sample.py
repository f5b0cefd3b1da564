"""Section ``sample``: the embedded sample."""

from typing import Annotated

from pydantic import Field

from pipeline.base.params import ImageSize, Section, Seed

FewFrames = Annotated[int, Field(ge=1, le=100_000)]
Rays = Annotated[int, Field(ge=1, le=10_000)]


class Frames(Section):
    """Frames per drive of each split."""

    train: FewFrames
    val: FewFrames
    test: FewFrames


class Sample(Section):
    key = "sample"
    seed: Seed
    image_size: ImageSize
    frames: Frames
    scan_rays: Annotated[tuple[Rays, Rays], Field(strict=False, description="[rings, rays per ring] of the LiDAR")]
