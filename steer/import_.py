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

import dataclasses
import math
import shlex
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from pipeline.base.errors import InputError
from pipeline.base.params import SPLITS
from steer import options

Offset = Annotated[float, options.number(-1e10, 1e10, "seconds to add to the times of --motion and --wheel")]
Gap = Annotated[float, options.number(0, 3600, "longest interval between samples that is interpolated, seconds")]
Start = Annotated[float, options.number(0, 1e10, "leave out earlier images, seconds since the first")]
End = Annotated[float | None, options.number(0, 1e10, "leave out this and later images")]
_SPLIT = "write three consecutive drives with these shares of the time in %, and presets/DRIVE.yaml"
Horizon = Annotated[float | None, options.number(-10000, 10000, "row of the road's horizon; default: estimated")]
Split = Annotated[str | None, typer.Option(metavar="TRAIN,VAL,TEST", help=_SPLIT)]


def import_recording(
    recording: Annotated[Path, typer.Argument(help="video, or folder of images")],
    drive: Annotated[str, typer.Option(help="name of the drive, for instance 2027_03_31_drive_0001")],
    motion: options.Motion = None,
    wheel: options.Wheel = None,
    steering_ratio: options.SteeringRatio = None,
    out: Annotated[Path, typer.Option(help="root folder of drives in KITTI raw's layout")] = Path("data/raw"),
    calib: options.Calib = None,
    fov: options.Fov = None,
    k: options.K = None,
    distortion: options.Distortion = None,
    horizon: Horizon = None,
    times: options.Times = None,
    fps: options.Fps = None,
    offset: Offset = 0.0,
    max_gap: Gap = 2.0,
    start: Start = 0.0,
    end: End = None,
    split: Split = None,
    camera_height: options.CameraHeight = None,
    replace: Annotated[bool, typer.Option("--replace", help="replace unchanged drives of an earlier import")] = False,
    quiet: options.Quiet = False,
    as_json: options.Json = False,
    debug: options.Debug = False,
) -> None:
    """Write drives and print what to do next; the module's docstring is the help text."""
    from pipeline.settings.preset import PRESETS
    from pipeline.video import drive_preset
    from pipeline.video.import_recording import Import
    from pipeline.video.lens import find_horizon, pinhole, undistortion
    from pipeline.video.log import check_ratio, read_motion, read_wheel
    from pipeline.video.recording import open_recording

    output = options.Output(quiet, as_json)
    check_ratio(wheel, steering_ratio)
    if end is not None and end <= start:
        raise InputError(f"--end {end:g} is not after --start {start:g}")
    shares = _shares(split)
    preset = PRESETS / f"{drive}.yaml" if split else None
    if preset:
        drive_preset.check_unchanged(preset)
    log = read_motion(motion, offset) if motion else None
    angles = read_wheel(wheel, steering_ratio, offset) if wheel and steering_ratio else None
    opened = open_recording(recording, fps, times)
    if opened.fps is None and opened.times_s is None:
        raise InputError("images have no times", recording, "Pass --fps N, or --times FILE")
    camera = pinhole(opened.size, calib=calib, fov_deg=fov, K=k)
    if distortion:
        opened.straighten = undistortion(camera, distortion)
    camera = dataclasses.replace(camera, horizon=find_horizon(opened.frames(), camera) if horizon is None else horizon)
    work = Import(opened, camera, log, angles, max_gap, start, math.inf if end is None else end)
    summary = work.write(out, drive, shares, replace=replace, visible=output.visible)
    labels = "oxts" if log else "wheel" if angles else "visual"
    if preset:
        drive_preset.write(preset, summary["manifests"], labels, summary["hz"], camera, camera_height)
    for line in _lines(summary, out, labels, camera_height, preset):
        output.line(line)
    output.result(summary | {"preset": preset, "K": camera.K.tolist()})


def _shares(split: str | None) -> list[float]:
    """Return the shares of the duration in %, 100 without --split. Raises InputError."""
    if split is None:
        return [100.0]
    try:
        shares = [float(share) for share in split.split(",")]
    except ValueError:
        shares = []
    if len(shares) != len(SPLITS) or not all(share > 0 for share in shares) or not math.isclose(sum(shares), 100):
        raise InputError(f"expected three shares above 0 with the sum 100, got {split!r}", "--split", "Pass 60,20,20")
    return shares


def _lines(
    summary: Mapping[str, Any], out: Path, labels: str, height_m: float | None, preset: Path | None
) -> Iterator[str]:
    """Yield what was written, and how to train; with a preset, the commands can be copied."""
    from pipeline.base.resume import ROOT

    for (drive, frames), folder in zip(summary["drives"].items(), summary["folders"], strict=True):
        yield f"{drive}: {frames} of {summary['images']} images, written to {folder}"
    row = summary["horizon"]
    yield "{first_s:.3f} to {last_s:.3f} s, {steering_angles} steering angles".format_map(summary)
    yield f"horizon: {'not found, assuming a level camera (or pass --horizon)' if row is None else f'row {row:.0f}'}"
    first, manifest = next(iter(summary["manifests"].items()))
    if preset is None:
        height = f", perception.camera_height_m: {height_m:g}" if height_m else ""
        settings = f"ingest.source: kitti, ingest.manifests: {{{first}: {manifest}}}, labels.source: {labels}{height}"
        yield f"next: set {settings} in params.yaml, replace ingest.drives by {first} and others, run dvc repro"
        return
    yield f"settings: {preset}"
    raw, date = ROOT / "data" / "raw", first[:10]
    link = f"mkdir -p {raw} && ln -sfT {shlex.quote(str(out.resolve() / date))} {raw / date} && "
    place = "" if Path.cwd() == ROOT else f" -C {shlex.quote(str(ROOT))}"
    yield f"next: {'' if out.resolve() == raw.resolve() else link}make{place} street && make{place} {preset.stem}"
