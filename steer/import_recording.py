"""steer import: convert your own recording to a drive in KITTI raw's layout, which all stages read."""

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

import typer

from pipeline.base.errors import InputError
from steer import options


def import_recording(
    source: Annotated[Path, typer.Argument(metavar="SOURCE", help="video, or folder of images; undistorted")],
    drive: Annotated[str, typer.Option(help="name of the drive, for instance 2027_03_31_drive_0001")],
    motion: Annotated[
        Path | None,
        typer.Option(help="CSV with time_s, speed_mps, yaw_rate_radps (left +); or GPX, NMEA"),
    ] = None,
    wheel: Annotated[Path | None, typer.Option(help="CSV with wheel_rad (left +) and time_s or frame")] = None,
    steering_ratio: Annotated[
        float | None,
        options.number(1, 50, "angle of the steering wheel / angle of the front wheels"),
    ] = None,
    out: Annotated[Path, typer.Option(help="root folder of drives in KITTI raw's layout")] = Path("data/raw"),
    calib: options.Calib = None,
    fov: options.Fov = None,
    k: options.K = None,
    times: options.Times = None,
    fps: options.Fps = None,
    offset: Annotated[float, options.number(-1e10, 1e10, "seconds to add to the times of --motion and --wheel")] = 0.0,
    max_gap: Annotated[
        float, options.number(0, 3600, "longest interval between samples that is interpolated, seconds")
    ] = 2.0,
    force: Annotated[bool, typer.Option("--force", help="replace an existing drive")] = False,
    quiet: options.Quiet = False,
    as_json: options.Json = False,
    debug: options.Debug = False,
) -> None:
    """Convert your own recording to a drive in KITTI raw's layout.

    Times count from the first image; images of a folder may be named by timestamps in ns. With --motion, speed and yaw
    rate are interpolated linearly at the images' times, and images without motion are left out. Without --motion,
    labels come from the images (labels.source: visual in params.yaml) or from the angles of --wheel (labels.source:
    wheel).

    A GPX or NMEA track has times in seconds since 1970 (UTC). Its speeds and courses are smoothed over a second or
    more, and one fix per second flattens bends. Prefer the car's own log, or a receiver with 5 Hz that reports
    velocities.

    \b
    steer import drive.mp4 --fov 78 --drive 2027_03_31_drive_0001
    steer import drive.mp4 --fov 78 --wheel wheel.csv --steering-ratio 14.8 --drive 2027_03_31_drive_0002
    steer import drive.mp4 --fov 78 --motion can.csv --offset 0.35 --drive 2027_03_31_drive_0003
    """
    from pipeline.camera.footage import open_footage
    from pipeline.camera.intrinsics import pinhole
    from pipeline.recording import layout
    from pipeline.recording.motion_log import read_motion, read_wheel
    from pipeline.recording.recording import Recording

    output = options.Output(quiet, as_json)
    options.check_names(source, motion, wheel, out, calib, times)
    if (wheel is None) != (steering_ratio is None):
        fix = "Pass both; a ratio of 1 if the log holds angles of the front wheels"
        raise InputError("--wheel and --steering-ratio need each other", fix=fix)
    layout.drive_folder(out, drive, force)
    log = read_motion(motion, offset) if motion else None
    angles = read_wheel(wheel, steering_ratio, offset) if wheel and steering_ratio else None
    footage = open_footage(source, fps, times)
    if not footage.has_times:
        raise InputError("images have no times", source, "Pass --fps N, or --times FILE")
    camera = pinhole(footage.size, calib=calib, fov_deg=fov, K=k)
    recording = Recording(footage, camera, log, angles, max_gap)
    recording.check_overlap()
    summary = recording.write(out, drive, force=force, visible=output.visible)
    for line in _lines(summary):
        output.line(line)
    output.result(summary | {"K": camera.K.tolist()})


def _lines(summary: dict[str, Any]) -> Iterator[str]:
    """Yield the lines of the log."""
    height, width = summary["size"]
    images = "{drive}: {frames} of {images} images, {first_s:.3f} to {last_s:.3f} s".format_map(summary)
    yield f"{images}, {width} x {height} pixels, written to {summary['folder']}"
    labels = "wheel" if summary["steering_angles"] else "visual"
    if summary["steering_angles"]:
        yield "{steering_angles} recorded steering angles".format_map(summary)
    if summary["motion"]:
        labels = "oxts"
        gaps = "{interpolated} frames interpolated, samples up to {largest_gap_s:.3g} s apart".format_map(summary)
        yield f"motion: {summary['motion']}; {gaps if summary['interpolated'] else 'a sample at each frame'}"
        if summary["frames"] < summary["images"]:
            left_out = "{before} before the first sample, {after} after the last, {in_gaps} in gaps"
            yield f"left out, no motion: {left_out.format_map(summary['left_out'])}"
    elif labels == "visual":
        yield "no recorded motion: labels will come from the motion that stage motion measures in the images"
    if summary["untimed_from"] is not None:
        yield f"the video's timestamps end at image {summary['untimed_from']}; later times follow from its frame rate"
    settings = f"ingest.source: kitti and labels.source: {labels}"
    yield f"next: set {settings} in params.yaml, add {summary['drive']} to ingest.drives, run dvc repro"
