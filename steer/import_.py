"""Convert your own recording to a drive in KITTI raw's layout.

Times count from the first image; images of a folder may be named by timestamps in ns. With --motion, speed and yaw
rate are interpolated linearly at the images' times, and images without motion are left out. Without --motion,
labels come from the images (labels.source: visual in params.yaml) or from the angles of --wheel (labels.source:
wheel).

With --split, 60,20,20 for instance, a single recording is enough to train and test networks: DRIVE and the two
following numbers get the first 60 %, the next 20 % and the last 20 % of the time, less 2 s between them. The last
line says how to train.

Images are written without the distortion of the lens. Stages crop them around the horizon, which is estimated from
the motion unless --horizon gives its row.

\b
steer import drive.mp4 --fov 78 --drive 2027_03_31_drive_0001
steer import drive.mp4 --fov 78 --wheel wheel.csv --steering-ratio 14.8 --drive 2027_03_31_drive_0002
steer import drive.mp4 --fov 78 --motion can.csv --offset 0.35 --drive 2027_03_31_drive_0003
steer import drive.mp4 --fov 78 --motion can.csv --split 60,20,20 --drive 2027_03_31_drive_0004
"""

import math
from pathlib import Path
from typing import Annotated

import typer

from pipeline.base.errors import InputError
from pipeline.base.params import SPLITS
from steer import options

_SPLIT = "write three consecutive drives with these shares of the time in %, and presets/DRIVE.yaml"
Split = Annotated[str | None, typer.Option(metavar="TRAIN,VAL,TEST", help=_SPLIT)]


def import_recording(
    recording: Annotated[list[Path], typer.Argument(help="videos in order, or a folder of videos or of images")],
    drive: Annotated[str, typer.Option(help="name of the drive, for instance 2027_03_31_drive_0001")],
    motion: options.Motion = None,
    wheel: options.Wheel = None,
    steering_ratio: options.SteeringRatio = None,
    out: Annotated[Path, typer.Option(help="root folder of drives in KITTI raw's layout")] = Path("data/raw"),
    fov: options.Fov = None,
    k: options.K = None,
    distortion: options.Distortion = None,
    fisheye: options.Fisheye = None,
    horizon: Annotated[float | None, options.number(-1e4, 1e4, "row of the road's horizon; default: estimated")] = None,
    times: options.Times = None,
    fps: options.Fps = None,
    offset: options.Offset = 0.0,
    start: Annotated[float, options.number(0, 1e10, "leave out earlier images, seconds since the first")] = 0.0,
    end: Annotated[float, options.number(0, math.inf, "leave out this and later images")] = math.inf,
    split: Split = None,
    camera_height: options.CameraHeight = None,
    replace: Annotated[bool, typer.Option("--replace", help="replace unchanged drives of an earlier import")] = False,
) -> None:
    """Write drives and print what to do next; the module's docstring is the help text."""
    from pipeline.settings.preset import PRESETS, is_unedited
    from pipeline.video.import_recording import import_drives, write_preset
    from pipeline.video.lens import numbers
    from pipeline.video.log import Logs
    from pipeline.video.source import Capture, open_images

    shares = numbers(split, (len(SPLITS),), "--split 60,20,20") if split else [100.0]
    if min(shares) <= 0 or not math.isclose(sum(shares), 100):
        raise InputError(f"expected shares above 0 with the sum 100, got {split}", "--split", "Pass 60,20,20")
    preset = PRESETS / f"{drive}.yaml" if split else None
    if preset and preset.exists() and not is_unedited(preset):
        raise InputError("is not as steer import wrote it", preset, "Move it away, or pass another --drive")
    logs = Logs.read(wheel, steering_ratio, motion, offset)
    opened = open_images(recording, Capture(fov, k, distortion, horizon, fps, times, fisheye), logs)
    imported = import_drives(opened, out, drive, shares, (start, end), replace=replace)
    labels = "oxts" if logs.motion else "wheel" if logs.wheel else "visual"
    for name, images in imported.images.items():
        print(f"{out / name[:10] / name}_sync: {images} images")
    print(*opened.notes, sep="\n")
    if preset:
        write_preset(preset, imported, labels, opened.camera, camera_height)
        print(f"next: make street && make {preset.stem}")
        return
    height = f", perception.camera_height_m: {camera_height:g}" if camera_height else ""
    manifest = f"{{{drive}: {imported.manifests[drive]}}}"
    encoder = "ingest.image_size: [192, 640], encoder.backbone: street, encoder.weights: weights/street/encoder.pt"
    settings = f"ingest.source: kitti, ingest.manifests: {manifest}, {encoder}, labels.source: {labels}{height}"
    print(f"next: make street; in params.yaml, set {settings}, and list {drive} and others in ingest.drives; dvc repro")
