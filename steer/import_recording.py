"""steer import: convert a recording of one's own to a drive in KITTI raw's layout, which all stages read."""

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

import typer

from pipeline.base.errors import InputError
from steer.options import Debug, Json, Output, Quiet


def import_recording(
    source: Annotated[Path, typer.Argument(help="video, or folder of PNG or JPEG images; undistorted")],
    drive: Annotated[str, typer.Option(help="name of the drive, for instance 2027_03_31_drive_0001")],
    motion: Annotated[
        Path | None, typer.Option(help="CSV with time_s, speed_mps, yaw_rate_radps (left +); or GPX, NMEA")
    ] = None,
    wheel: Annotated[
        Path | None, typer.Option(help="CSV with wheel_rad (steering wheel, left +), and time_s or frame")
    ] = None,
    steering_ratio: Annotated[
        float | None, typer.Option(help="angle of the steering wheel / angle of the front wheels, 1 to 50")
    ] = None,
    out: Annotated[Path, typer.Option(help="root in KITTI raw's layout; ingest reads data/raw")] = Path("data/raw"),
    calib: Annotated[Path | None, typer.Option(help="intrinsics: a KITTI calib_cam_to_cam.txt")] = None,
    fov: Annotated[float | None, typer.Option(help="intrinsics: horizontal field of view, degrees")] = None,
    K: Annotated[str | None, typer.Option("--K", help="intrinsics: fx,fy,cx,cy in pixels")] = None,
    times: Annotated[Path | None, typer.Option(help="times of the images: seconds, one per line")] = None,
    fps: Annotated[float | None, typer.Option(help="times of the images: images per second, 0.01 to 1000")] = None,
    offset: Annotated[float, typer.Option(help="seconds to add to the times of motion and wheel")] = 0.0,
    max_gap: Annotated[float, typer.Option(help="longest interval between samples to interpolate over, s")] = 2.0,
    force: Annotated[bool, typer.Option("--force", help="replace an existing drive")] = False,
    quiet: Quiet = False,
    as_json: Json = False,
    debug: Debug = False,
) -> None:
    """Convert a video, or a folder of images, to a drive in KITTI raw's layout.

    Times count from the first image; images of a folder may be named by timestamps in ns. With --motion, speed and yaw
    rate are interpolated linearly at the images' times, and images without motion are left out. Without it, labels come
    from the images (labels.source: visual in params.yaml) or, with --wheel, from these angles (labels.source: wheel).

    A GPX or NMEA track has times in seconds since 1970 (UTC); its speeds and courses are smoothed over a second or
    more. One fix per second flattens bends: prefer the car's own log, or a receiver with 5 Hz that reports velocities.

    \b
    steer import drive.mp4 --fov 78 --drive 2027_03_31_drive_0001
    steer import drive.mp4 --fov 78 --wheel wheel.csv --steering-ratio 14.8 --drive 2027_03_31_drive_0002
    steer import drive.mp4 --fov 78 --motion can.csv --offset 0.35 --drive 2027_03_31_drive_0003
    """
    from pipeline.camera.intrinsics import pinhole
    from pipeline.recording import clock, layout
    from pipeline.recording.motion_log import read_motion, read_wheel
    from pipeline.recording.recording import Recording

    output = Output(quiet, as_json)
    _check_paths(source, motion, wheel, out, calib, times)
    _check_numbers(fps, offset, max_gap, steering_ratio)
    if (wheel is None) != (steering_ratio is None):
        raise InputError("expected both of --wheel and --steering-ratio", fix="A ratio of 1 takes front wheels' angles")
    layout.check_absent(layout.drive_folder(out, drive), force)
    log = read_motion(motion, offset) if motion else None
    angles = read_wheel(wheel, steering_ratio, offset) if wheel and steering_ratio else None
    footage, times_s = clock.open_timed(source, fps, times)
    camera = pinhole(footage.size, calib=calib, fov_deg=fov, K=K)
    recording = Recording(footage, camera, times_s, log, angles, max_gap)
    recording.check_overlap()
    summary = recording.write(out, drive, force=force, visible=output.visible)
    for line in _lines(summary):
        output.line(line)
    output.result(summary | {"K": camera.K.tolist()})


def _check_paths(*paths: Path | None) -> None:
    """Raise InputError for names that are not UTF-8, which cannot be printed or written as JSON."""
    for path in paths:
        try:
            str(path).encode()
        except UnicodeEncodeError:
            raise InputError("name is not valid UTF-8", repr(os.fsencode(str(path))), "Rename it") from None


def _check_numbers(fps: float | None, offset: float, max_gap: float, steering_ratio: float | None) -> None:
    for option, value, lowest, highest in (
        ("--fps", fps, 0.01, 1000),
        ("--offset", offset, -1e10, 1e10),
        ("--max-gap", max_gap, 0, 3600),
        ("--steering-ratio", steering_ratio, 1, 50),
    ):
        if value is not None and not lowest <= value <= highest:  # also NaN
            raise InputError(f"expected {lowest:g} to {highest:g}, got {value:g}", option)


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
