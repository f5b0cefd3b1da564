"""Section ``perception``: running the unified encoder."""

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from pipeline.base.params import Count, Positive, Section

DepthScale = Literal["metric", "camera_height", "lidar_median", "none"]


class Perception(Section):
    key = "perception"
    batch: Count
    depth_scale: Annotated[
        DepthScale,
        Field(description="where metres come from: the network, the camera's height over the road, LiDAR, nowhere"),
    ] = "metric"
    camera_height_m: Annotated[Positive | None, Field(description="over the road; null: from the calibration")] = None
    reach: Annotated[
        Annotated[float, Field(ge=1)] | None,
        Field(description="how many times as far as flat ground at its foot traffic is, at most; null: any"),
    ] = None
    precision: Literal["auto", "bfloat16", "float32"] = "auto"

    @model_validator(mode="after")
    def _reach_is_of_metres(self) -> Self:
        if self.reach and self.depth_scale == "none":
            raise ValueError("reach is of depth in metres: leave it out with depth_scale: none")
        return self
