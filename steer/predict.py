"""steer predict: the steering of a drive, a folder of images, a video or a camera, frame by frame."""

from pathlib import Path
from typing import Annotated

import typer

from steer.options import Debug, Json, Quiet


def predict(
    source: Annotated[
        str, typer.Argument(help="a KITTI drive's folder, a folder of images, a video, a camera's number")
    ],
    quiet: Quiet = False,
    as_json: Json = False,
    debug: Debug = False,
) -> None:
    """Predict."""
    raise NotImplementedError(source, Path)
