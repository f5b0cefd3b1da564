"""Import your own recording: write a preset that trains networks on its first part and tests them
on its last.

data/raw/NAME gets links to the files, or copies (--copy), and presets/NAME.yaml the parts: 60 %, 20
% and 20 % of the time, less 2 s between them. Then `make NAME` runs the chain. An edited log is
noticed by `make NAME`.

Times count from the first image; images of a folder may be named by timestamps in ns. With
--motion, speed and yaw rate are interpolated linearly at the images' times, and images without
motion are left out. Without it, labels come from the angles of --wheel or, without both, from the
images.

With --each, each recording is a drive of its own: for training, validation, test, training, …

\b steer import monday.mp4 --fov 78 steer import monday.mp4 --fov 78 --wheel wheel.csv
--steering-ratio 14.8 steer import monday.mp4 --fov 78 --motion can.csv --offset 0.35 --split
70,15,15 steer import a.mp4 b.mp4 c.mp4 --each --name week --fov 78 --motion a.csv --motion b.csv
--motion c.csv
"""

import math
from pathlib import Path
from typing import Annotated, Any

import typer

from pipeline.base.errors import InputError
from pipeline.base.params import SPLITS

_SPLIT = "shares of the time in %; default: 60,20,20"
# Options that are passed once per recording with --each; cameras may also share one K.
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
    from pipeline.base.errors import error_context
    from pipeline.base.params import check_name, from_python
    from pipeline.camera.lens import numbers
    from pipeline.check.preset import PRESETS
    from pipeline.ingest.log import read_logs
    from pipeline.ingest.names import check_different
    from pipeline.ingest.recording import open_recording
    from pipeline.ingest.settings import KITTI_NAMES, Part
    from steer import import_recording as importing

    shares = numbers(split or "60,20,20", (len(SPLITS),), "--split 60,20,20")
    if min(shares) <= 0 or not math.isclose(sum(shares), 100):
        raise InputError(
            f"expected shares above 0 with the sum 100, got {split}", "--split", "Pass 60,20,20"
        )
    if each and (len(recording) < 2 or split or options.get("times")):
        raise InputError(
            "--each needs two recordings or more, and takes neither --split nor --times"
        )
    groups = [recording]
    if each:
        groups = [[path] for path in recording]
        shares = [100.0]
        check_different(recording)
    own = {option: options.pop(option) for option in EACH if options.get(option)}
    for option, given in own.items():
        if len(given) != len(groups) and (option != "K" or len(given) > 1):
            problem = f"expected {len(groups)}, one per recording (got {len(given)})"
            raise InputError(
                problem, f"--{option}", "" if each else "With --each, each path is a recording"
            )

    name = name or recording[0].stem
    with error_context("--name"):
        check_name(name)
    preset = PRESETS / f"{name}.yaml"
    raw = PRESETS.parent / "data/raw"
    folders = [f"{name}-{number + 1}" for number in range(len(groups))] if each else [name]
    importing.check_checkout(Path.cwd())
    importing.check_free(
        preset, {raw / folder: paths for folder, paths in zip(folders, groups, strict=True)}
    )

    # Faults of all options and logs are found before the first video is decoded.
    wholes = []
    for number, folder in enumerate(folders):
        of_recording = {option: given[number % len(given)] for option, given in own.items()}
        whole = from_python(Part, {**options, **of_recording, "folder": folder, "files": {}})
        read_logs(whole)
        wholes.append(whole)

    recordings = []
    contents = {}
    parts = []
    for paths, whole in zip(groups, wholes, strict=True):
        opened = open_recording(paths, whole)
        files = importing.files_of(paths, whole, opened.scan)
        parts += importing.cut_recording(opened, whole, files, shares)
        recordings.append(opened)
        contents[raw / whole.folder] = files

    # Names of the drives, and their splits.
    splits = (
        ["train", "test"]
        if len(parts) == 2
        else [SPLITS[number % 3] for number in range(len(parts))]
    )
    names = [f"{name}-{number if each else split}" for number, split in enumerate(splits, 1)]
    if KITTI_NAMES.fullmatch(name):
        names = [f"{name[:-4]}{int(name[-4:]) + number:04d}" for number in range(len(parts))]
    drives = {drive: (of, *part) for drive, of, part in zip(names, splits, parts, strict=True)}

    with importing.linked(contents, copy=copy):
        source = "recorded" if "motion" in own else "wheel" if "wheel" in own else "visual"
        importing.write_preset(preset, drives, recordings[0], source)
    for drive, (of, _, images) in drives.items():
        print(f"{drive}: {images} images, {of}")
    for opened, whole in zip(recordings, wholes, strict=True):
        begin = f"{whole.folder}: " if each else ""
        for line in [*opened.notes, *(f"doubt: {text}" for text in opened.doubts)]:
            print(begin + line)
    print(f"next: make street && make {preset.stem}")
