"""Section ``motion``: the car's motion since the previous frame."""

from typing import Annotated, Literal

from pydantic import Field

from pipeline.base.params import Section

Kind = Literal["visual", "lidar"]


class Motion(Section):
    key = "motion"
    kinds: Annotated[
        tuple[Kind, ...], Field(min_length=1, description="measured from visual (images and depth) or lidar (scans)")
    ]
    road_scale: Annotated[bool, Field(description="correct depth's scale by the camera's height over the road")] = True
