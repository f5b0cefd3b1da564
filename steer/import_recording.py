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
    from pipeline.recording.motion_log import MotionLog
    from pipeline.recording.track import Rates


def import_recording(
    source: Annotated[Path, typer.Argument(help="video, or folder of PNG or JPEG images; undistorted")],
    motion: Annotated[Path, typer.Option(help="CSV with time_s, speed_mps, yaw_rate_radps (left +); or GPX, NMEA")],
    drive: Annotated[str, typer.Option(help="name of the drive, for instance 2027_03_31_drive_0001")],
    out: Annotated[Path, typer.Option(help="root in KITTI raw's layout; stage ingest reads data/raw")] = Path(
        "data/raw"
    ),
    calib: Annotated[Path | None, typer.Option(help="intrinsics: a KITTI calib_cam_to_cam.txt")] = None,
    fov: Annotated[float | None, typer.Option(help="intrinsics: horizontal field of view, degrees")] = None,
    K: Annotated[str | None, typer.Option("--K", help="intrinsics: fx,fy,cx,cy in pixels")] = None,
    times: Annotated[Path | None, typer.Option(help="times of the images: seconds, one per line")] = None,
    fps: Annotated[float | None, typer.Option(help="times of the images: images per second, 0.01 to 1000")] = None,
    offset: Annotated[float, typer.Option(help="seconds to add to the motion's times")] = 0.0,
    max_gap: Annotated[float, typer.Option(help="longest interval between samples to interpolate over, s")] = 2.0,
    force: Annotated[bool, typer.Option("--force", help="replace an existing drive")] = False,
    quiet: Quiet = False,
    as_json: Json = False,
    debug: Debug = False,
) -> None:
    """Convert a video, or a folder of images, and the car's speed and yaw rate to a drive in KITTI raw's layout.

    Speed and yaw rate are interpolated linearly at the images' times, which count from the first image. Images without
    motion are left out. A GPX or NMEA track has times in seconds since 1970 (UTC); its speeds and courses are smoothed
    over a second or more. One fix per second flattens bends: prefer the car's own log, or a receiver with 5 Hz that
    reports velocities. Then set ingest.source: kitti in params.yaml, add the drive to ingest.drives, and run dvc repro.

    Example: steer import drive.mp4 --motion can.csv --fov 78 --offset 0.35 --drive 2027_03_31_drive_0001
    """
    from pipeline.base.atomic import replacing
    from pipeline.base.lock import exclusive
    from pipeline.camera.footage import open_footage
    from pipeline.camera.intrinsics import intrinsics
    from pipeline.recording import clock, layout
    from pipeline.recording.motion_log import read_motion

    output = Output(quiet, as_json)
    _check_paths(source, motion, out, calib, times)
    _check_range("--fps", fps, 0.01, 1000)
    _check_range("--offset", offset, -1e10, 1e10)
    _check_range("--max-gap", max_gap, 0, 3600)
    if times and fps:
        raise InputError("expected one source of the images' times, got two", fix="Pass --times or --fps")
    folder = layout.drive_folder(out, drive)
    _check_absent(folder, force)
    log = read_motion(motion, offset)
    footage = open_footage(source, fps)
    matrix = intrinsics(footage.size, calib=calib, fov_deg=fov, K=K)
    times_s = clock.read_times(times) if times else None
    clock.check_overlap(log.rates, *_span(footage, times_s))

    # One lock per date, as its drives share a calibration.
    with exclusive(folder.parent, out / ".import" / drive[:10]), replacing(folder) as unfinished:
        _check_absent(folder, force)
        calibrated = layout.check_calibration(folder, footage.size, matrix, force)
        time_s, covered = _write(unfinished, footage, times_s, log, max_gap, output)
        if not calibrated:
            layout.write_calibration(folder, footage.size, matrix)

    summary = {"drive": drive} | _summary(folder, footage, time_s, covered)
    for line in _lines(log.source, summary):
        output.line(line)
    output.result(summary | {"motion": log.source, "K": matrix.tolist()})


def _write(
    folder: Path, footage: "Footage", times_s: "np.ndarray | None", log: "MotionLog", max_gap: float, output: Output
) -> tuple["np.ndarray", "Coverage"]:
    """Write the images that have motion, and their packets; return the times of all images and which are usable."""
    import numpy as np

    from pipeline.base.executors import default_workers
    from pipeline.recording import clock, layout
    from pipeline.recording.packets import packets

    all_s: list[float] = []
    images = _with_motion(footage, times_s, log.rates, max_gap, all_s, output)
    layout.write_images(folder, images, threads=default_workers())
    time_s = np.array(all_s)
    covered = clock.coverage(log.rates, time_s, max_gap)
    if not covered.usable.any():
        raise InputError(f"no image lies between samples at most {max_gap:g} s apart", "--motion", "Raise --max-gap")
    layout.write_packets(folder, packets(log.rates, time_s[covered.usable]), covered.usable, time_s)
    return time_s, covered


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
    footage: "Footage", times_s: "np.ndarray | None", rates: "Rates", max_gap: float, all_s: list[float], output: Output
) -> Iterator[tuple[int, "np.ndarray"]]:
    """Yield number and pixels of the images that have motion, and append the times of all images to `all_s`."""
    import numpy as np
    from tqdm import tqdm

    from pipeline.recording import clock

    with tqdm(total=footage.count, unit=" images", disable=not (output.visible and sys.stderr.isatty())) as bar:
        for time_s, image in clock.timed(footage, times_s):
            all_s.append(time_s)
            if clock.coverage(rates, np.array([time_s]), max_gap).usable[0]:
                yield image.number, image.image
            bar.update()


def _summary(folder: Path, footage: "Footage", time_s: "np.ndarray", covered: "Coverage") -> dict[str, Any]:
    usable_s = time_s[covered.usable]
    return {
        "folder": str(folder),
        "images": len(time_s),
        "frames": len(usable_s),
        "size": list(footage.size),
        "first_s": float(usable_s[0]),
        "last_s": float(usable_s[-1]),
        "interpolated": covered.interpolated,
        "largest_gap_s": covered.largest_gap_s,
        "left_out": {"before": covered.before, "after": covered.after, "in_gaps": covered.in_gaps},
        "untimed_from": getattr(footage, "untimed_from", None),
    }


def _lines(source: str, summary: dict[str, Any]) -> Iterator[str]:
    """Yield the lines of the log."""
    height, width = summary["size"]
    images = "{drive}: {frames} of {images} images, {first_s:.3f} to {last_s:.3f} s".format_map(summary)
    yield f"{images}, {width} x {height} pixels, written to {summary['folder']}"
    interpolated = "{interpolated} frames interpolated, samples up to {largest_gap_s:.3g} s apart".format_map(summary)
    yield f"motion: {source}; {interpolated if summary['interpolated'] else 'a sample at each frame'}"
    if summary["frames"] < summary["images"]:
        left_out = "{before} before the first sample, {after} after the last, {in_gaps} in gaps"
        yield f"left out, no motion: {left_out.format_map(summary['left_out'])}"
    if summary["untimed_from"] is not None:
        yield f"the video's timestamps end at image {summary['untimed_from']}; later times follow from its frame rate"
    yield f"next: set ingest.source: kitti in params.yaml, add {summary['drive']} to ingest.drives, run dvc repro"
