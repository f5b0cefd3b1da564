"""Measure the motion and the course of a car from the frames of its camera, by visual odometry.

Rates and angles are in rad (curvature in 1/m), left positive. A frame whose motion cannot be measured has valid = 0 and
no numbers. quality.json says how certain the scale is.

\b
steer measure street.mp4 --fov 65
steer measure data/sample/2026_01_18/2026_01_18_drive_0004_sync --encoder data/encoder
"""

from pathlib import Path
from typing import Annotated

import typer

from steer.commands import arguments

STREET = Path("weights/street")


def measure(
    source: arguments.SourcePath,
    out: arguments.Out = None,
    fov_deg: arguments.Fov = None,
    K: arguments.K = None,
    distortion: arguments.Distortion = None,
    fisheye: arguments.Fisheye = None,
    fps: arguments.Fps = None,
    times: arguments.Times = None,
    camera_height_m: arguments.CameraHeight = None,
    wheelbase: Annotated[float, arguments.number(0.5, 20, "distance between the axles, metres")] = 2.7,
    wheel: arguments.Wheel = None,
    steering_ratio: arguments.SteeringRatio = None,
    motion: arguments.Motion = None,
    offset_s: arguments.Offset = 0.0,
    video: arguments.Video = True,
    encoder: Annotated[Path, typer.Option(help="folder of an encoder; make street writes the default one")] = STREET,
) -> None:
    """Write the measured motion and print its quality; the module's docstring is the help text."""
    from steer import api

    arguments.run(api.measure, locals(), encoder=encoder, wheelbase_m=wheelbase)
