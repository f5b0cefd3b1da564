"""steer import: a lab's own recording becomes a drive in KITTI raw's layout, which all stages read."""

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from steer.options import Debug, Json, Quiet, Voice

if TYPE_CHECKING:  # what is large waits until the command runs: help is quick
    import numpy as np

    from pipeline.camera.footage import Footage
    from pipeline.recording.clock import Coverage
    from pipeline.recording.track import Rates


def import_recording(
    source: Annotated[Path, typer.Argument(help="a video, or a folder of PNG or JPEG images; undistorted")],
    motion: Annotated[Path, typer.Option(help="CSV with time_s, speed_mps, yaw_rate_radps (left +); or GPX, NMEA")],
    drive: Annotated[str, typer.Option(help="the drive's name, as 2027_03_31_drive_0001")],
    out: Annotated[Path, typer.Option(help="root in KITTI raw's layout; stage ingest reads data/raw")] = Path(
        "data/raw"
    ),
    calib: Annotated[Path | None, typer.Option(help="intrinsics: a KITTI calib_cam_to_cam.txt")] = None,
    fov: Annotated[float | None, typer.Option(help="intrinsics: horizontal field of view, degrees")] = None,
    K: Annotated[str | None, typer.Option("--K", help="intrinsics: fx,fy,cx,cy in pixels")] = None,
    times: Annotated[Path | None, typer.Option(help="the images' times: seconds, one per line")] = None,
    fps: Annotated[float | None, typer.Option(min=0.01, help="the images' times: how many a second")] = None,
    offset: Annotated[float, typer.Option(help="seconds that are added to the motion's times")] = 0.0,
    max_gap: Annotated[float, typer.Option(min=0, help="seconds between samples that are interpolated over")] = 2.0,
    force: Annotated[bool, typer.Option("--force", help="replace a drive that is there")] = False,
    quiet: Quiet = False,
    as_json: Json = False,
    debug: Debug = False,
) -> None:
    """Turn a video, or a folder of images, and the car's speed and yaw rate into a drive in KITTI raw's layout.

    Speed and yaw rate are interpolated linearly to the images' times, which count from a recording's first image;
    images without motion are left out. A GPX or NMEA track has times in seconds since 1970 (UTC), and its speeds and
    courses are smoothed by parabolas over a second or more: one fix a second flattens bends, so prefer the car's own
    log, or a receiver of 5 Hz that says velocities.
    Then set ingest.source: kitti in params.yaml, name the drive in ingest.drives, and run dvc repro.

    Example: steer import drive.mp4 --motion can.csv --fov 78 --offset 0.35 --drive 2027_03_31_drive_0001
    """
    import numpy as np

    from pipeline.base.atomic import replacing
    from pipeline.base.errors import InputError
    from pipeline.base.executors import default_workers
    from pipeline.camera.footage import open_footage
    from pipeline.camera.intrinsics import intrinsics
    from pipeline.recording import clock, layout
    from pipeline.recording.motion_log import read_motion
    from pipeline.recording.packets import packets

    voice = Voice(quiet, as_json)
    folder = layout.drive_folder(out, drive)
    if folder.exists() and not force:
        raise InputError(f"{folder} is there already: --force replaces it, or give --drive another number")
    if times and fps:
        raise InputError("--times and --fps both say when the images were taken: give one of them")
    log = read_motion(motion, offset)
    footage = open_footage(source, fps)
    matrix = intrinsics(footage.size, calib=calib, fov_deg=fov, K=K)
    layout.check_calibration(folder, footage.size, matrix, force)
    times_s = clock.read_times(times) if times else None
    clock.check_overlap(log.rates, *_span(footage, times_s))

    with replacing(folder) as unfinished:
        seen_s: list[float] = []
        images = _with_motion(footage, times_s, log.rates, max_gap, seen_s, voice)
        layout.write_images(unfinished, images, threads=default_workers())
        time_s = np.array(seen_s)
        covered = clock.coverage(log.rates, time_s, max_gap)
        if not covered.kept.any():
            raise InputError(f"no image lies between two samples that are {max_gap:g} s apart or less: raise --max-gap")
        rows = packets(log.rates, time_s[covered.kept])
        layout.write_packets(unfinished, rows, covered.kept, time_s)
        layout.write_calibration(folder, footage.size, matrix)

    summary = {"drive": drive} | _summary(folder, footage, time_s, covered)
    for line in _lines(log.source, summary):
        voice.line(line)
    voice.result(summary | {"motion": log.source, "K": matrix.tolist()})


def _span(footage: "Footage", times_s: "np.ndarray | None") -> tuple[float, float]:
    """Return the images' first and last time, the last of a video as it announces it, or at any time."""
    if times_s is not None:
        return float(times_s[0]), float(times_s[-1])
    return 0.0, (footage.count - 1) / footage.fps if footage.count and footage.fps else float("inf")


def _with_motion(
    footage: "Footage", times_s: "np.ndarray | None", rates: "Rates", max_gap: float, seen_s: list[float], voice: Voice
) -> Iterator[tuple[int, "np.ndarray"]]:
    """Yield number and pixels of the images that have motion, and append the times of all to `seen_s`."""
    import numpy as np
    from tqdm import tqdm

    from pipeline.recording import clock

    bar = tqdm(total=footage.count, unit=" images", disable=not (voice.talks and sys.stderr.isatty()))
    with bar:
        for time_s, image in clock.timed(footage, times_s):
            seen_s.append(time_s)
            if clock.coverage(rates, np.array([time_s]), max_gap).kept[0]:
                yield image.number, image.image
            bar.update()


def _summary(folder: Path, footage: "Footage", time_s: "np.ndarray", covered: "Coverage") -> dict[str, Any]:
    kept_s = time_s[covered.kept]
    return {
        "folder": str(folder),
        "images": len(time_s),
        "frames": len(kept_s),
        "size": list(footage.size),
        "first_s": float(kept_s[0]),
        "last_s": float(kept_s[-1]),
        "interpolated": covered.interpolated,
        "largest_gap_s": covered.largest_gap_s,
        "left_out": {"before": covered.before, "after": covered.after, "in_gaps": covered.in_gaps},
        "untimed_from": getattr(footage, "untimed_from", None),
    }


def _lines(source: str, summary: dict[str, Any]) -> Iterator[str]:
    """Yield what people read of an import."""
    height, width = summary["size"]
    span = "{first_s:.3f} to {last_s:.3f} s".format_map(summary)
    images = "{drive}: {frames} of {images} images".format_map(summary)
    yield f"{images}, {width} x {height}, {span}, in {summary['folder']}"
    interpolated = "{interpolated} frames interpolated, samples up to {largest_gap_s:.3g} s apart".format_map(summary)
    yield f"motion: {source}; {interpolated if summary['interpolated'] else 'each frame is at a sample'}"
    if summary["frames"] < summary["images"]:
        left_out = "{before} before its first sample, {after} after its last, {in_gaps} in gaps"
        yield f"without motion, left out: {left_out.format_map(summary['left_out'])}"
    if summary["untimed_from"] is not None:
        yield f"the video's timestamps stop at image {summary['untimed_from']}: then its frame rate tells times"
    yield f"next: in params.yaml ingest.source: kitti and {summary['drive']} in ingest.drives, then dvc repro"
