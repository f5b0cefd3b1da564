"""Import your own recording: write a preset that trains networks on its first part and tests them on its last.

data/raw/NAME gets links to the files, or copies (--copy), and presets/NAME.yaml the parts: 60 %, 20 % and 20 % of the
time, less 2 s between them. Then `make NAME` runs the chain. An edited log is noticed by `make NAME`.

Times count from the first image; images of a folder may be named by timestamps in ns. With --motion, speed and yaw
rate are interpolated linearly at the images' times, and images without motion are left out. Without it, labels come
from the angles of --wheel or, without both, from the images.

With --each, each recording is a drive of its own: for training, validation, test, training, …

\b
steer import monday.mp4 --fov 78
steer import monday.mp4 --fov 78 --wheel wheel.csv --steering-ratio 14.8
steer import monday.mp4 --fov 78 --motion can.csv --offset 0.35 --split 70,15,15
steer import a.mp4 b.mp4 c.mp4 --each --name week --fov 78 --motion a.csv --motion b.csv --motion c.csv
"""

import math
from pathlib import Path
from typing import Annotated, Any

import typer

from pipeline.base.errors import InputError
from pipeline.base.params import SPLITS
from steer.commands import arguments

_SPLIT = "shares of the time in %; default: 60,20,20"
Logs = Annotated[list[Path] | None, typer.Option(metavar="CSV", help="log; with --each, one per recording")]


def import_recording(
    recording: Annotated[list[Path], typer.Argument(help="videos in order, or a folder of videos or of images")],
    name: Annotated[str | None, typer.Option(help="of the preset; default: the file's")] = None,
    motion: Logs = None,
    wheel: Logs = None,
    steering_ratio: arguments.SteeringRatio = None,
    fov: arguments.Fov = None,
    k: Annotated[
        list[str] | None, typer.Option("--K", metavar="FX,FY,CX,CY", help="intrinsics; with --each, one or each's")
    ] = None,
    distortion: arguments.Distortion = None,
    fisheye: arguments.Fisheye = None,
    horizon: Annotated[
        float | None, arguments.number(-1e4, 1e4, "row of the road's horizon; default: estimated")
    ] = None,
    times: arguments.Times = None,
    fps: arguments.Fps = None,
    offset: arguments.Offset = 0.0,
    start: Annotated[float, arguments.number(0, 1e10, "leave out earlier images, seconds since the first")] = 0.0,
    end: Annotated[float | None, arguments.number(0, 1e10, "leave out this and later images")] = None,
    split: Annotated[str | None, typer.Option(metavar="TRAIN,VAL,TEST", help=_SPLIT)] = None,
    each: Annotated[bool, typer.Option("--each", help="each recording is a drive, in turn for each split")] = False,
    camera_height: arguments.CameraHeight = None,
    copy: Annotated[bool, typer.Option("--copy", help="copy the files instead of linking them")] = False,
) -> None:
    """Write links and a preset; the module's docstring is the help text."""
    from pipeline.base.errors import error_context
    from pipeline.base.params import check_name
    from pipeline.camera.lens import numbers
    from pipeline.check.preset import PRESETS
    from pipeline.ingest.datasets.recording import MOTION, TIMES, WHEEL, read_logs
    from pipeline.ingest.names import check_different
    from pipeline.ingest.settings import KITTI_NAMES, Part
    from steer import import_recording as importing

    chosen: Any = {name: value for name, value in locals().items() if name in Part.model_fields}
    shares = numbers(split or "60,20,20", (len(SPLITS),), "--split 60,20,20")
    if min(shares) <= 0 or not math.isclose(sum(shares), 100):
        raise InputError(f"expected shares above 0 with the sum 100, got {split}", "--split", "Pass 60,20,20")
    groups = [[path] for path in recording] if each else [recording]
    if each and (len(groups) < 2 or split or times):
        raise InputError("--each needs two recordings or more, and takes neither --split nor --times")
    for option, given in (("--motion", motion), ("--wheel", wheel), ("--K", k)):
        if given and len(given) != len(groups) and (option != "--K" or len(given) > 1):
            problem = f"expected {len(groups)}, one per recording (got {len(given)})"
            raise InputError(problem, option, "With --each, each path is a recording" * (not each))
    name, raw = name or recording[0].stem, PRESETS.parent / "data/raw"
    with error_context("--name"):
        check_name(name)
    preset = PRESETS / f"{name}.yaml"
    folders = [f"{name}-{number + 1}" for number in range(len(groups))] if each else [name]
    importing.check_free(preset, [raw / folder for folder in folders])
    check_different(recording if each else [])
    takes = []
    for number, (folder, paths) in enumerate(zip(folders, groups, strict=True)):
        part = Part(folder=folder, files={}, K=k[number % len(k)] if k else None, **chosen)
        logs = {WHEEL: wheel[number] if wheel else None, MOTION: motion[number] if motion else None, TIMES: times}
        read_logs(part, logs)  # finds faults of all logs before the first video is decoded
        takes.append((paths, logs, part))
    opened = [importing.open_recording(*take, [100.0] if each else shares) for take in takes]
    parts = [part for one in opened for part in one.parts]
    splits = ["train", "test"] if len(parts) == 2 else [SPLITS[number % 3] for number in range(len(parts))]
    names = [f"{name}-{number if each else split}" for number, split in enumerate(splits, 1)]
    if KITTI_NAMES.fullmatch(name):
        names = [f"{name[:-4]}{int(name[-4:]) + number:04d}" for number in range(len(parts))]
    drives = {drive: (of, *part) for drive, of, part in zip(names, splits, parts, strict=True)}
    with importing.linked(opened, raw, copy=copy):
        source = "recorded" if motion else "wheel" if wheel else "visual"
        importing.write_preset(preset, drives, opened[0], source)
    for drive, (of, _, images) in drives.items():
        print(f"{drive}: {images} images, {of}")
    for one in opened:
        begin = f"{one.folder}: " if each else ""
        for line in [*one.recording.notes, *(f"doubt: {text}" for text in one.recording.doubts)]:
            print(begin + line)
    print(f"next: make street && make {preset.stem}")
