"""Predict the steering angle, or the path ahead, of each frame with a trained model.

The video shows the angle as the path of a car that keeps it. A predicted path is shown beside the
one that the car took afterwards, by a log or by the measured motion. Angles are in rad, left
positive. The first frames, and those after a gap, have no angle until a window of frames is
complete. LiDAR scans and oxts are needed only by models with LiDAR input. steering.csv also has
the measured motion, without means over later frames: see steer measure.

\b
steer predict street.mp4 --fov 65 --model runs/monday/data/train/motion
steer predict data/sample/2026_06_01/2026_06_01_drive_0001_sync --model models/steering/sample_path
"""

from pathlib import Path
from typing import Annotated, Any

import typer

from pipeline.base.errors import InputError
from steer.commands import arguments


def predict(
    source: arguments.SourcePath,
    model: Annotated[Path | None, typer.Option(help="folder of a trained model")] = None,
    out: arguments.Out = None,
    video: arguments.Video = True,
    encoder: Annotated[
        Path | None,
        typer.Option(
            help="folder of an encoder; default: data/encoder beside the model's data/train"
        ),
    ] = None,
    **options: Any,
) -> None:
    """Write the predicted angles, and print errors; the module's docstring is the help text."""
    from steer import api

    if model is None:
        fix = (
            "Measure the angle: steer measure (nmse 0.008 on real drives). "
            "Or name a network of yours. That of --model models/steering/sample "
            "has seen rendered streets only (nmse 1.22 on a real drive)"
        )
        raise InputError("no network for real streets is included", "--model", fix)
    arguments.run_command(
        api.predict, source, out, video=video, model=model, encoder=encoder, **options
    )
