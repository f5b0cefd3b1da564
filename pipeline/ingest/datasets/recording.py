"""Videos and folders of images with logs of the car: parts of recordings in data/raw, as ingest.recordings has them."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from pipeline.base.errors import InputError
from pipeline.base.resume import content_hash
from pipeline.camera.camera import Camera
from pipeline.camera.images import format_size
from pipeline.camera.lens import fisheye, pinhole, undistortion
from pipeline.ingest.drive import Drive
from pipeline.ingest.log import ROUNDING_S, Logs
from pipeline.ingest.media import Recording, open_recording
from pipeline.ingest.settings import Ingest, Part

VIDEO, FRAMES = "video", "frames"  # beginnings of the names of files in a folder of data/raw
WHEEL, MOTION, TIMES = "wheel.csv", "motion.csv", "times.txt"


class Capture(NamedTuple):
    """Options for a recording, which has no calibration of its own; None: not given."""

    fov_deg: float | None = None
    K: str | None = None
    distortion: str | None = None
    fisheye: str | None = None
    fps: float | None = None
    times: Path | None = None


def fingerprint(name: str, settings: Ingest, root: Path) -> list[Any]:
    """Return the part's settings, which hold the hashes of its files. Raises InputError for a file of another hash.

    Files may be missing on a machine that fetches finished drives.
    """
    part = settings.recordings[name]
    for path, expected in _paths(part, root).items():
        if path.exists() and _hash(path, path.stat().st_mtime_ns) != expected:
            fix = "Run it with the new file: make NAME of its preset, or make params PRESET=NAME"
            raise InputError("is not the file whose hash ingest.recordings has", path, fix)
    return [part.model_dump(mode="json")]


@cache  # the parts of a recording have the same files
def _hash(path: Path, _: int) -> str:
    return content_hash(path)


def open_drive(name: str, settings: Ingest, root: Path) -> Drive:
    """Return the part of a recording; images without motion, if there is a log of it, are left out."""
    part = settings.recordings[name]
    paths = _paths(part, root)
    if missing := [path for path in paths if not path.exists()]:
        gone = f"the link's target {missing[0].readlink()}" if missing[0].is_symlink() else "the file"
        fix = "Repeat steer import, or fetch finished drives: dvc repro --pull --allow-missing"
        raise InputError(f"{gone} is missing", missing[0], fix)
    recording, camera, logs = open_part(part, {path.name: path for path in paths})
    used = usable(recording.times_s, logs, part.start, part.end)
    if not used.any():
        raise InputError("no image is left from start to end, or none with motion", f"ingest.recordings.{name}")
    camera = replace(camera, horizon=part.horizon).at_height(part.camera_height)
    values = logs.values(np.flatnonzero(used), recording.times_s[used])
    recording.times_s = recording.times_s - recording.times_s[used][0]
    return Drive(camera, partial(recording.frames, used), values, recording.notes)


def read_logs(part: Part, files: Mapping[str, Path | None]) -> Logs:
    """Read the logs of a recording, by their names in its folder and the options of a `part`."""
    return Logs.read(files.get(WHEEL), part.steering_ratio, files.get(MOTION), part.offset)


def open_part(part: Part, files: Mapping[str, Path]) -> tuple[Recording, Camera, Logs]:
    """Open the images and logs of a recording, by their names in its folder and the options of a `part`."""
    logs = read_logs(part, files)
    capture = Capture(part.fov, part.K, part.distortion, part.fisheye, part.fps, files.get(TIMES))
    images = [path for name, path in files.items() if name.startswith((VIDEO, FRAMES))]
    return *open_images(images, capture, logs), logs


def _paths(part: Part, root: Path) -> dict[Path, str]:
    """Return the files of a recording with their hashes, videos in order."""
    return {root / part.folder / name: expected for name, expected in part.files.items()}


def open_images(
    paths: Sequence[Path], capture: Capture, logs: Logs, hz: float | None = None
) -> tuple[Recording, Camera]:
    """Open a recording of rectified images, `hz` of them per second, after `logs` are compared with its times."""
    recording = open_recording(paths, capture.fps, capture.times, logs.check_overlap)
    if recording.size[0] > recording.size[1]:
        sizes = f"images are taller than wide ({format_size(recording.size)} pixels): is it rotated by 90 degrees?"
        raise InputError(sizes, recording.path, "Rotate it: ffmpeg -i in.mp4 -vf transpose=1 out.mp4 (or transpose=2)")
    if capture.distortion and capture.fisheye:
        raise InputError("expected one model of the lens, got two", fix="Pass --distortion or --fisheye")
    if capture.fisheye:
        camera, recording.straighten = fisheye(recording.size, capture.fisheye, capture.fov_deg, capture.K)
    else:
        camera = pinhole(recording.size, capture.fov_deg, capture.K)
    if capture.distortion:
        recording.straighten = undistortion(camera, capture.distortion)
    if hz:
        recording.resample(hz)
    return recording, camera


def usable(time_s: np.ndarray, logs: Logs, start_s: float, end_s: float | None) -> np.ndarray:
    """Return which images bool [F] at `time_s` [F] lie in [start, end) since the first, and have a logged motion."""
    elapsed_s = time_s - time_s[0] + ROUNDING_S
    used = (elapsed_s > start_s) & (elapsed_s <= (math.inf if end_s is None else end_s))
    return used & np.isfinite(logs.motion.at(time_s)[0]) if logs.motion else used
