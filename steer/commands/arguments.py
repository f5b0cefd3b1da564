"""Options that several commands share."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from steer.outcome import Outcome


def number(lowest: float, highest: float, help: str, *name: str) -> Any:
    """Return an option for a number from `lowest` to `highest`; `name`: if it is not the parameter's."""
    return typer.Option(*name, min=lowest, max=highest, help=help)


# Of predict, measure and import. A KITTI drive has its own intrinsics and times.
SourcePath = Annotated[
    list[Path],
    typer.Argument(metavar="SOURCE...", help="folder of a KITTI drive, of images or of videos, or videos in order"),
]
Out = Annotated[Path | None, typer.Option(help="new or empty folder for the results; default: out/SOURCE")]
Fov = Annotated[float | None, number(5, 170, "intrinsics: horizontal field of view, degrees", "--fov")]
K = Annotated[str | None, typer.Option("--K", metavar="FX,FY,CX,CY", help="intrinsics: in pixels")]
Distortion = Annotated[
    str | None, typer.Option(metavar="K1,K2,P1,P2[,K3]", help="lens distortion by OpenCV's model; default: none")
]
Fisheye = Annotated[
    str | None, typer.Option(metavar="K1,K2,K3,K4", help="of a fisheye lens, by OpenCV's model; 0,0,0,0: equidistant")
]
Fps = Annotated[float | None, number(0.01, 1000, "times: images per second; default: a video's own times")]
Times = Annotated[Path | None, typer.Option(help="times: a file with the seconds of each image, one per line")]
CameraHeight = Annotated[float | None, number(0.3, 5, "height of the camera over the road, metres", "--camera-height")]
Motion = Annotated[Path | None, typer.Option(help="CSV with time_s, speed_mps, yaw_rate_radps (left +)")]
Wheel = Annotated[Path | None, typer.Option(help="CSV with time_s and wheel_rad (left +)")]
SteeringRatio = Annotated[
    float | None, number(-50, 50, "steering wheel's angle / front wheels'; negative: turns the sign")
]
Offset = Annotated[float, number(-1e10, 1e10, "seconds to add to the times of --motion and --wheel", "--offset")]
Video = Annotated[bool, typer.Option(help="write overlay.mp4")]


def run(function: Callable[..., "Outcome"], arguments: Mapping[str, Any], **others: Any) -> None:
    """Call a function of `steer.api` for a free folder; print notes, files, and at most three doubts at the end.

    `arguments`: a command's, of which those that all commands share are passed; `others`: its own.
    """
    from pipeline.base.outputs import claim
    from steer.api import Options

    shared = {name: arguments[name] for name in ("source", "video", *Options.__annotations__)}
    out = claim(arguments["out"], arguments["source"][0].resolve().stem.removesuffix("_sync"))
    outcome = function(out=out, **shared, **others)
    print(*outcome.notes, ", ".join(map(str, outcome.files)), sep="\n")
    print(*(f"doubt: {text}" for text in outcome.doubts[:3]), sep="\n", end="\n" * bool(outcome.doubts))
