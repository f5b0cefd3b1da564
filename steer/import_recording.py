"""steer import: convert a recording of one's own to a drive in KITTI raw's layout, which all stages read."""

import math
import os
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from pipeline.base.errors import InputError
from steer.options import Debug, Json, Output, Quiet

if TYPE_CHECKING:  # heavy imports wait until the command runs, so that --help is fast
    import numpy as np

    from pipeline.camera.footage import Footage
    from pipeline.recording.clock import Coverage
    from pipeline.recording.motion_log import MotionLog, WheelLog


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
    out: Annotated[Path, typer.Option(help="root in KITTI raw's layout; stage ingest reads data/raw")] = Path(
        "data/raw"
    ),
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
    from pipeline.base.atomic import exclusive, replacing
    from pipeline.camera.footage import open_footage
    from pipeline.camera.intrinsics import intrinsics
    from pipeline.recording import clock, layout
    from pipeline.recording.motion_log import read_motion, read_wheel

    output = Output(quiet, as_json)
    _check_paths(source, motion, wheel, out, calib, times)
    _check_range("--fps", fps, 0.01, 1000)
    _check_range("--offset", offset, -1e10, 1e10)
    _check_range("--max-gap", max_gap, 0, 3600)
    _check_range("--steering-ratio", steering_ratio, 1, 50)
    if (wheel is None) != (steering_ratio is None):
        fix = "Pass both: a ratio of 1 takes angles of the front wheels"
        raise InputError("expected --wheel together with --steering-ratio", fix=fix)
    if times and fps:
        raise InputError("expected one source of the images' times, got two", fix="Pass --times or --fps")
    folder = layout.drive_folder(out, drive)
    _check_absent(folder, force)
    log = read_motion(motion, offset) if motion else None
    angles = read_wheel(wheel, steering_ratio, offset) if wheel and steering_ratio else None
    footage = open_footage(source, fps)
    matrix = intrinsics(footage.size, calib=calib, fov_deg=fov, K=K)
    times_s = clock.read_times(times) if times else None
    if log:
        clock.check_overlap("motion", log.rates.time_s, *_span(footage, times_s))
    if angles and angles.time_s is not None:
        clock.check_overlap("wheel angles", angles.time_s, *_span(footage, times_s))

    # One lock per date, as its drives share a calibration.
    with exclusive(folder.parent, out / ".import" / drive[:10]), replacing(folder) as unfinished:
        _check_absent(folder, force)
        calibrated = layout.check_calibration(folder, footage.size, matrix, force)
        time_s, usable, recorded = _write(unfinished, footage, times_s, log, angles, max_gap, output)
        if not calibrated:
            layout.write_calibration(folder, footage.size, matrix)

    covered = clock.coverage(log.rates.time_s, time_s, max_gap) if log else None
    summary = {"drive": drive} | _summary(folder, footage, time_s[usable], len(time_s), covered)
    summary |= {"motion": log.source if log else None, "steering_angles": recorded}
    for line in _lines(summary):
        output.line(line)
    output.result(summary | {"K": matrix.tolist()})


def _write(
    folder: Path,
    footage: "Footage",
    times_s: "np.ndarray | None",
    log: "MotionLog | None",
    angles: "WheelLog | None",
    max_gap: float,
    output: Output,
) -> tuple["np.ndarray", "np.ndarray", int]:
    """Write the images, those that have motion if there is a log, with their packets and steering angles.

    Returns the times of all images, which of them were written, and the number of angles.
    """
    import numpy as np

    from pipeline.base.executors import default_workers
    from pipeline.kitti import steering_file
    from pipeline.recording import clock, layout
    from pipeline.recording.packets import packets

    all_s: list[float] = []
    images = _with_motion(footage, times_s, log, max_gap, all_s, output)
    layout.write_images(folder, images, threads=default_workers())
    time_s, recorded = np.array(all_s), {}
    usable = clock.coverage(log.rates.time_s, time_s, max_gap).usable if log else np.ones(len(time_s), bool)
    if not usable.any():
        raise InputError(f"no image lies between samples at most {max_gap:g} s apart", "--motion", "Raise --max-gap")
    if log:
        layout.write_packets(folder, packets(log.rates, time_s[usable]), usable)
    layout.write_times(folder, usable, time_s, (layout.IMAGES, "oxts") if log else (layout.IMAGES,))
    if angles:
        recorded = angles.at(time_s, usable, max_gap)
        if not recorded:
            raise InputError("no image has an angle", "--wheel", "Check its times or frames, or raise --max-gap")
        steering_file.write(folder / steering_file.NAME, recorded)
    return time_s, usable, len(recorded)


def _check_paths(*paths: Path | None) -> None:
    """Raise InputError for names that are not UTF-8, which cannot be printed or written as JSON."""
    for path in paths:
        try:
            str(path).encode()
        except UnicodeEncodeError:
            raise InputError("name is not valid UTF-8", repr(os.fsencode(str(path))), "Rename it") from None


def _check_range(option: str, value: float | None, lowest: float, highest: float) -> None:
    if value is not None and not (math.isfinite(value) and lowest <= value <= highest):
        raise InputError(f"expected {lowest:g} to {highest:g}, got {value:g}", option)


def _check_absent(folder: Path, force: bool) -> None:
    if folder.exists() and not force:
        raise InputError("drive exists", folder, "Replace it with --force, or pass --drive another number")


def _span(footage: "Footage", times_s: "np.ndarray | None") -> tuple[float, float]:
    """Return the images' first and last time; inf if a video does not announce its length."""
    if times_s is not None:
        return float(times_s[0]), float(times_s[-1])
    return 0.0, (footage.count - 1) / footage.fps if footage.count and footage.fps else math.inf


def _with_motion(
    footage: "Footage",
    times_s: "np.ndarray | None",
    log: "MotionLog | None",
    max_gap: float,
    all_s: list[float],
    output: Output,
) -> Iterator[tuple[int, "np.ndarray"]]:
    """Yield number and pixels of the images, of those that have motion if there is a `log`.

    Appends the times of all images to `all_s`.
    """
    import numpy as np
    from tqdm import tqdm

    from pipeline.recording import clock

    with tqdm(total=footage.count, unit=" images", disable=not (output.visible and sys.stderr.isatty())) as bar:
        for time_s, image in clock.timed(footage, times_s):
            all_s.append(time_s)
            if log is None or clock.coverage(log.rates.time_s, np.array([time_s]), max_gap).usable[0]:
                yield image.number, image.image
            bar.update()


def _summary(
    folder: Path, footage: "Footage", usable_s: "np.ndarray", images: int, covered: "Coverage | None"
) -> dict[str, Any]:
    summary: dict[str, Any] = {
        "folder": str(folder),
        "images": images,
        "frames": len(usable_s),
        "size": list(footage.size),
        "first_s": float(usable_s[0]),
        "last_s": float(usable_s[-1]),
        "untimed_from": getattr(footage, "untimed_from", None),
    }
    if covered:
        left_out = {"before": covered.before, "after": covered.after, "in_gaps": covered.in_gaps}
        gaps = {"interpolated": covered.interpolated, "largest_gap_s": covered.largest_gap_s}
        summary |= gaps | {"left_out": left_out}
    return summary


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
