"""Import your own recording: make its drives, and a preset that trains on its first part.

The recording is converted once, to drives in KITTI's layout in data/raw/NAME: 60 %, 20 % and 20 %
of the time, less 2 s between them, for training, validation and test. presets/NAME.yaml has the
settings of `make NAME`, which runs the chain. After an edit of a log, repeat the import.

Times count from the first image. Values of --motion and --wheel are interpolated at the images'
times. Without --motion, labels come from the angles of --wheel. Without both, they are measured in
the images.

With --each, each file is a drive of its own: for training, validation, test, training, …

\b
steer import monday.mp4 --fov 78
steer import monday.mp4 --fov 78 --wheel wheel.csv --steering-ratio 14.8
steer import monday.mp4 --fov 78 --motion can.csv --offset 0.35 --split 70,15,15
steer import a.mp4 b.mp4 c.mp4 --each --name week --fov 78 --motion a.csv --motion b.csv \\
    --motion c.csv
"""

import re
from pathlib import Path
from typing import Annotated, Any

import typer

from pipeline.base.errors import InputError

# Logs of all recordings.
Logs = list[Path] | None


def import_recordings(
    recording: Annotated[list[Path], typer.Argument(help="videos in order, or a folder of images")],
    name: Annotated[str | None, typer.Option(help="of the preset; default: the file's")] = None,
    split: Annotated[
        str,
        typer.Option(metavar="TRAIN,VAL,TEST", help="shares of the time in %"),
    ] = "60,20,20",
    each: Annotated[
        bool, typer.Option("--each", help="each recording is a drive, in turn for each split")
    ] = False,
    motion: Annotated[
        Logs,
        typer.Option(
            help="CSV with time_s, speed_mps, yaw_rate_radps (left +); with --each, one per file"
        ),
    ] = None,
    wheel: Annotated[
        Logs,
        typer.Option(help="CSV with time_s and wheel_rad (left +); with --each, one per file"),
    ] = None,
    **options: Any,
) -> None:
    """Write drives and a preset; the module's docstring is the help text."""
    from footage.settings import Options
    from pipeline.base.checkout import is_checkout
    from pipeline.base.params import from_python
    from steer import importing

    if not is_checkout():
        fix = "Clone it: git clone …; then run make setup and .venv/bin/steer import there"
        raise InputError("steer import needs a checkout of the project", fix=fix)
    shares = importing.read_shares(split)
    groups = [recording]
    if each:
        if len(recording) < 2 or options.get("times"):
            raise InputError("--each needs two recordings or more, and takes no --times")
        shares = [100.0]
        groups = [[path] for path in recording]
    logs = {
        "motion": importing.divide_logs(motion, "--motion", len(groups)),
        "wheel": importing.divide_logs(wheel, "--wheel", len(groups)),
    }
    all_options = []
    for number in range(len(groups)):
        log_of = {kind: paths[number] for kind, paths in logs.items()}
        all_options.append(from_python(Options, {**options, **log_of}))
    name = name or re.sub("[^A-Za-z0-9_-]+", "-", recording[0].stem)
    for line in importing.write_import(name, groups, all_options, shares):
        print(line)
