"""Declare the options of a recording, which are those of its conversion to drives."""

from pathlib import Path
from typing import Annotated

from pydantic import Field

from pipeline.base.params import Section

# A path. It is not strict, so that a text is taken, too.
File = Annotated[Path | None, Field(strict=False)]


class Options(Section):
    """Options of a recording: the lens, the images' times, the camera's height, logs of the car.

    The command line uses the aliases, Python the names with units.
    """

    fov_deg: float | None = Field(
        default=None,
        alias="fov",
        ge=5,
        le=170,
        description="intrinsics: horizontal field of view, degrees",
    )
    K: str | None = Field(
        default=None, description="intrinsics: in pixels", examples=["FX,FY,CX,CY"]
    )
    distortion: str | None = Field(
        default=None,
        description="lens distortion by OpenCV's model; default: none",
        examples=["K1,K2,P1,P2[,K3]"],
    )
    fisheye: str | None = Field(
        default=None,
        description="of a fisheye lens, by OpenCV's model; 0,0,0,0: equidistant",
        examples=["K1,K2,K3,K4"],
    )
    fps: float | None = Field(
        default=None,
        ge=0.01,
        le=1000,
        description="times: images per second; default: a video's own times",
    )
    times: File = Field(
        default=None, description="times: a file with the seconds of each image, one per line"
    )
    camera_height_m: float | None = Field(
        default=None,
        alias="camera_height",
        ge=0.3,
        le=5,
        description="height of the camera over the road, metres",
    )
    motion: File = Field(
        default=None, description="CSV with time_s, speed_mps, yaw_rate_radps (left +)"
    )
    wheel: File = Field(default=None, description="CSV with time_s and wheel_rad (left +)")
    steering_ratio: float | None = Field(
        default=None,
        description="steering wheel's angle / front wheels'; negative: turns the sign",
    )
    offset_s: float = Field(
        default=0.0,
        alias="offset",
        ge=-1e10,
        le=1e10,
        description="seconds to add to the times of --motion and --wheel",
    )
    png: bool = Field(default=False, description="write images as PNG files, without loss")
