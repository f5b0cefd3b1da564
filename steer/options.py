"""Options that several commands share, and their output: text for people, or one JSON object."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer


def number(lowest: float, highest: float, help: str) -> Any:
    """Return an option for a number from `lowest` to `highest`."""
    return typer.Option(min=lowest, max=highest, help=help)


Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="print errors only")]
Json = Annotated[bool, typer.Option("--json", help="print one JSON object and nothing else")]
Debug = Annotated[bool, typer.Option("--debug", help="show the traceback of errors")]
# Of predict, measure and import. A KITTI drive has its own intrinsics and times.
SourcePath = Annotated[
    Path, typer.Argument(metavar="SOURCE", help="folder of a KITTI drive, folder of images, or video")
]
Out = Annotated[Path | None, typer.Option(help="new or empty folder for the results; default: out/SOURCE")]
Fov = Annotated[float | None, typer.Option(help="intrinsics: horizontal field of view, degrees")]
K = Annotated[str | None, typer.Option("--K", metavar="FX,FY,CX,CY", help="intrinsics: in pixels")]
Distortion = Annotated[
    str | None,
    typer.Option(metavar="K1,K2,P1,P2[,K3]", help="lens distortion by OpenCV's model; default: none"),
]
Calib = Annotated[Path | None, typer.Option(help="intrinsics: a KITTI calib_cam_to_cam.txt")]
Fps = Annotated[float | None, number(0.01, 1000, "times: images per second; default: a video's own times")]
Times = Annotated[Path | None, typer.Option(help="times: a file with the seconds of each image, one per line")]
CameraHeight = Annotated[float | None, number(0.3, 5, "height of the camera over the road, metres")]
Motion = Annotated[Path | None, typer.Option(help="CSV with time_s, speed_mps, yaw_rate_radps (left +)")]
Wheel = Annotated[Path | None, typer.Option(help="CSV with wheel_rad (left +) and time_s or frame")]
SteeringRatio = Annotated[float | None, number(1, 50, "angle of the steering wheel / angle of the front wheels")]
Video = Annotated[bool, typer.Option(help="write overlay.mp4")]


class Output:
    """Standard output of a command."""

    def __init__(self, quiet: bool, as_json: bool) -> None:
        self.visible = not (quiet or as_json)
        """Whether text and progress bars are shown."""
        self._json = as_json

    def line(self, text: str) -> None:
        """Print a line of text."""
        if self.visible:
            print(text, flush=True)

    def result(self, content: Mapping[str, Any]) -> None:
        """Print the result as JSON, if ``--json`` is given; numbers that are not finite become null."""
        from pydantic_core import to_jsonable_python

        if self._json:
            print(json.dumps(to_jsonable_python(content, inf_nan_mode="null"), indent=1), flush=True)
