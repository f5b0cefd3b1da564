"""Measure the motion and the course of a car from the frames of its camera, by visual odometry.

A recording is first converted to a drive, OUT/drive, which can be a source again.

Rates and angles are in rad (curvature in 1/m), left positive. A frame whose motion cannot be
measured has valid = 0 and no numbers. quality.json says how certain the scale is.

\b
steer measure street.mp4 --fov 65
steer measure street.mp4 --fov 65 --camera-height 1.4 --wheel wheel.csv --steering-ratio 14.8
steer measure data/sample/2026_06_01/2026_06_01_drive_0004_sync --encoder data/encoder
"""

from pathlib import Path
from typing import Annotated, Any

import typer

from steer.commands import arguments


def measure(
    source: arguments.SourcePath,
    out: arguments.Out = None,
    video: arguments.Video = True,
    encoder: Annotated[
        Path | None,
        typer.Option(help="folder of an encoder; default: the one that steer street makes"),
    ] = None,
    wheelbase: Annotated[float, typer.Option(help="distance between the axles, metres")] = 2.7,
    **options: Any,
) -> None:
    """Write the measured motion and print its quality; the module's docstring is the help text."""
    from steer import api

    arguments.run_command(
        api.measure, source, out, video=video, encoder=encoder, wheelbase_m=wheelbase, **options
    )
