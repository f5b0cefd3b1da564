"""Section ``motion``: the car's motion since the previous frame."""

from typing import Annotated

from pydantic import Field

from pipeline.base.params import MotionKind, Section


class Motion(Section):
    key = "motion"
    kinds: Annotated[
        tuple[MotionKind, ...],
        Field(min_length=1, strict=False, description="measured from visual (images and depth) or lidar (scans)"),
    ]
    road_scale: Annotated[bool, Field(description="correct depth's scale by the camera's height over the road")] = True
