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

from steer import options

STREET = Path("weights/street")


def measure(
    source: options.SourcePath,
    out: options.Out = None,
    fov_deg: options.Fov = None,
    K: options.K = None,
    distortion: options.Distortion = None,
    fisheye: options.Fisheye = None,
    fps: options.Fps = None,
    times: options.Times = None,
    camera_height_m: options.CameraHeight = None,
    wheelbase: Annotated[float, options.number(0.5, 20, "distance between the axles, metres")] = 2.7,
    wheel: options.Wheel = None,
    steering_ratio: options.SteeringRatio = None,
    motion: options.Motion = None,
    offset_s: options.Offset = 0.0,
    video: options.Video = True,
    encoder: Annotated[Path, typer.Option(help="folder of an encoder; make street writes the default one")] = STREET,
) -> None:
    """Write the measured motion and print its quality; the module's docstring is the help text."""
    from steer import api

    options.run(api.measure, locals(), encoder=encoder, wheelbase_m=wheelbase)
