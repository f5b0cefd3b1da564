"""Import your own recording: write a preset that trains on its first part and tests on its last.

data/raw/NAME gets links to the files, or copies (--copy), and presets/NAME.yaml the parts: 60 %, 20
% and 20 % of the time, less 2 s between them. Then `make NAME` runs the chain. After an edit of a
log, repeat the import.

Times count from the first image; images of a folder may be named by timestamps in ns. With
--motion, speed and yaw rate are interpolated linearly at the images' times, and images without
motion are left out. Without --motion, labels come from the angles of --wheel. Without both, they
are measured in the images.

With --each, each recording is a drive of its own: for training, validation, test, training, …

\b
steer import monday.mp4 --fov 78
steer import monday.mp4 --fov 78 --wheel wheel.csv --steering-ratio 14.8
steer import monday.mp4 --fov 78 --motion can.csv --offset 0.35 --split 70,15,15
steer import a.mp4 b.mp4 c.mp4 --each --name week --fov 78 --motion a.csv --motion b.csv \\
    --motion c.csv
"""

import math
from pathlib import Path
from typing import Annotated, Any

import typer

from pipeline.base.errors import InputError
from pipeline.base.params import SPLITS

# Help of --split.
_SPLIT = "shares of the time in %; default: 60,20,20"
# Options that are passed once per recording if --each is given. A single K may also be that of all
# cameras.
EACH = ("motion", "wheel", "K")


def import_recording(
    recording: Annotated[
        list[Path], typer.Argument(help="videos in order, or a folder of videos or of images")
    ],
    name: Annotated[str | None, typer.Option(help="of the preset; default: the file's")] = None,
    split: Annotated[str | None, typer.Option(metavar="TRAIN,VAL,TEST", help=_SPLIT)] = None,
    each: Annotated[
        bool, typer.Option("--each", help="each recording is a drive, in turn for each split")
    ] = False,
    copy: Annotated[
        bool, typer.Option("--copy", help="copy the files instead of linking them")
    ] = False,
    **options: Any,
) -> None:
    """Write links and a preset; the module's docstring is the help text."""
    from pipeline.base.checkout import is_checkout

    if not is_checkout():
        fix = "Clone it: git clone …; then run make setup and .venv/bin/steer import there"
        raise InputError("steer import needs a checkout of the project", fix=fix)

    from pipeline.base.errors import error_context
    from pipeline.base.params import check_name, from_python
    from pipeline.check.preset import PRESETS
    from pipeline.ingest.log import read_logs
    from pipeline.ingest.names import check_different
    from pipeline.ingest.recording import open_recording
    from pipeline.ingest.settings import Part
    from steer import import_recording as importing

    # All files together are one recording. With --each, each file is a recording.
    shares = read_shares(split)
    groups = [recording]
    if each:
        if len(recording) < 2 or split or options.get("times"):
            problem = "--each needs two recordings or more, and takes neither --split nor --times"
            raise InputError(problem)
        check_different(recording)
        groups = [[path] for path in recording]
        shares = [100.0]
    options_of = divide_options(options, len(groups), each=each)

    # Each recording gets a folder in data/raw. All of them get one preset.
    name = name or recording[0].stem
    with error_context("--name"):
        check_name(name)
    preset = PRESETS / f"{name}.yaml"
    raw = PRESETS.parent / "data/raw"
    folders = [name]
    if each:
        folders = [f"{name}-{number + 1}" for number in range(len(groups))]
    images = {raw / folder: paths for folder, paths in zip(folders, groups, strict=True)}
    importing.check_checkout(Path.cwd())
    importing.check_free(preset, images)

    # Describe each recording by a part that spans it. Faults of all options and logs are found
    # before the first video is decoded.
    wholes = []
    for folder, own_options in zip(folders, options_of, strict=True):
        whole = from_python(Part, {**own_options, "folder": folder, "files": {}})
        read_logs(whole)
        wholes.append(whole)

    recordings = []
    contents = {}
    parts = []
    for paths, whole in zip(groups, wholes, strict=True):
        opened = open_recording(paths, whole)
        if not whole.hz:
            whole = whole.model_copy(update={"hz": opened.reduce()})
        files = importing.name_files(paths, whole, opened.scan)
        parts += importing.cut_recording(opened, whole, files, shares)
        recordings.append(opened)
        contents[raw / whole.folder] = files

    drives = importing.name_drives(name, parts, each=each)
    with importing.linked(contents, copy=copy):
        importing.write_preset(preset, drives, recordings[0], wholes[0])

    for drive in drives:
        print(f"{drive.name}: {drive.images} images, {drive.split}")
    for opened, whole in zip(recordings, wholes, strict=True):
        doubts = [f"doubt: {text}" for text in opened.doubts]
        for line in [*opened.notes, *doubts]:
            print(f"{whole.folder}: {line}" if each else line)
    print(f"next: make street && make {preset.stem}")


def read_shares(split: str | None) -> list[float]:
    """Return the shares of --split in %, by default 60, 20 and 20. Raises InputError."""
    from pipeline.camera.lens import numbers

    shares = numbers(split or "60,20,20", (len(SPLITS),), "--split 60,20,20")
    if min(shares) <= 0 or not math.isclose(sum(shares), 100):
        problem = f"expected shares above 0 with the sum 100, got {split}"
        raise InputError(problem, "--split", "Pass 60,20,20")
    return shares


def divide_options(options: dict[str, Any], count: int, *, each: bool) -> list[dict[str, Any]]:
    """Return the options of each of `count` recordings.

    Each option in EACH is a list with a value per recording. Raises InputError if a list has
    another length. A single K is that of all recordings.
    """
    divided = [dict(options) for _ in range(count)]
    for name in EACH:
        values = options.get(name)
        if not values:
            continue
        if name == "K" and len(values) == 1:
            values = values * count
        if len(values) != count:
            problem = f"expected {count}, one per recording (got {len(values)})"
            fix = "" if each else "With --each, each path is a recording"
            raise InputError(problem, f"--{name}", fix)
        for recording_options, value in zip(divided, values, strict=True):
            recording_options[name] = value
    return divided
