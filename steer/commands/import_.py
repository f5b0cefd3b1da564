"""Import your own recording: make its drives, and a preset that trains on its first part.

The recording is converted once, to drives in KITTI's layout in data/raw/NAME: the first 60 % of its
time for training, the next 20 % for validation, the last for test, with gaps of 2 s. Then `make
NAME` runs the chain with the settings of presets/NAME.yaml.

Logs of the car are --motion and --wheel. Their times count from the first image, and their values
are interpolated at the images' times. Without --motion, labels come from the angles of --wheel.
Without both, they are measured in the images. After an edit of a log, repeat the import.

\b
steer import monday.mp4 --fov 78
steer import monday.mp4 --fov 78 --wheel wheel.csv --steering-ratio 14.8
steer import monday.mp4 --fov 78 --motion can.csv --offset 0.35 --split 70,15,15
"""

import re
from pathlib import Path
from typing import Annotated, Any

import typer

from pipeline.base.errors import InputError


def import_recording(
    recording: Annotated[list[Path], typer.Argument(help="videos in order, or a folder of images")],
    name: Annotated[str | None, typer.Option(help="of the preset; default: the file's")] = None,
    split: Annotated[
        str,
        typer.Option(metavar="TRAIN,VAL,TEST", help="shares of the time in %"),
    ] = "60,20,20",
    **options: Any,
) -> None:
    """Write drives and a preset; the module's docstring is the help text.

    arguments.with_options adds the options of a recording, such as --fov and --motion.
    """
    from footage.settings import Options
    from pipeline.base.checkout import is_checkout
    from pipeline.base.params import from_python
    from steer import importing

    if not is_checkout():
        fix = "Clone it: git clone …; then run make setup and .venv/bin/steer import there"
        raise InputError("steer import needs a checkout of the project", fix=fix)
    shares = importing.read_shares(split)
    given = from_python(Options, options)
    name = name or re.sub("[^A-Za-z0-9_-]+", "-", recording[0].stem)
    for line in importing.write_import(name, recording, given, shares):
        print(line)
