"""Section ``perception``: depth and classes by the unified encoder."""

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from pipeline.base.params import Count, Positive, Precision, Section

DepthScale = Literal["metric", "camera_height", "lidar_median", "none"]


class Perception(Section):
    key = "perception"
    batch: Count
    depth_scale: Annotated[
        DepthScale,
        Field(description="source of metric scale: the network, the camera's height over the road, LiDAR, or none"),
    ] = "metric"
    camera_height_m: Annotated[Positive | None, Field(description="over the road; null: from the calibration")] = None
    reach: Annotated[
        Annotated[float, Field(ge=1)] | None,
        Field(description="cap on a vehicle's depth, relative to the ground depth below it; null: no cap"),
    ] = None
    precision: Precision = "auto"

    @model_validator(mode="after")
    def _reach_is_metric(self) -> Self:
        if self.reach and self.depth_scale == "none":
            raise ValueError("reach needs depth in metres: remove it with depth_scale: none")
        return self
