"""Section ``perception``: running the unified encoder."""

from typing import Annotated, Literal

from pydantic import Field

from pipeline.base.params import Count, Positive, Section
from pipeline.camera.mount import CAMERA_HEIGHT_M

DepthScale = Literal["metric", "camera_height", "lidar_median", "none"]


class Perception(Section):
    key = "perception"
    batch: Count
    depth_scale: Annotated[
        DepthScale,
        Field(description="where metres come from: the network, the camera's height over the road, LiDAR, nowhere"),
    ] = "metric"
    camera_height_m: Positive = CAMERA_HEIGHT_M
    reach: Annotated[
        Annotated[float, Field(ge=1)] | None,
        Field(description="how many times as far as flat ground at its foot traffic is, at most; null: any"),
    ] = None
    precision: Literal["auto", "bfloat16", "float32"] = "auto"
