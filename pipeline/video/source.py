"""Open what `steer measure` and `steer predict` read: a KITTI drive, a video, or a folder of images."""

import hashlib
import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

from pipeline.base.errors import DamagedFile, InputError
from pipeline.camera.camera import Camera, Frame
from pipeline.camera.images import format_size, read_image
from pipeline.camera.mount import check_height
from pipeline.kitti.raw import KittiDrive
from pipeline.video.horizon import find_horizon
from pipeline.video.lens import pinhole, undistortion
from pipeline.video.recording import open_recording

DEFAULT_FPS = 10.0  # KITTI's
ROTATE = "Rotate it: ffmpeg -i in.mp4 -vf transpose=1 out.mp4 (or transpose=2)"


class Lens(NamedTuple):
    """One of three ways to give intrinsics, see :func:`pipeline.video.lens.pinhole`; distortion of the lens."""

    calib: Path | None = None
    fov_deg: float | None = None
    K: str | None = None
    distortion: str | None = None  # see :func:`pipeline.video.lens.undistortion`


class Clock(NamedTuple):
    """One of two ways to give the images' times: images per second, or a file with a time in seconds per image."""

    fps: float | None = None
    times: Path | None = None


@dataclass(frozen=True)
class Source:
    """A camera and its frames."""

    path: Path
    name: str  # random draws depend on it
    camera: Camera  # of complete images; height_m is KITTI's unless height_known
    height_known: bool  # of the camera over the road
    frames: Callable[[], Iterator[Frame]]  # complete, rectified images; again with each call
    count: int | None  # number of frames, if known
    fps: float | None  # None: a KITTI drive, whose times are read with its frames
    notes: list[str]  # for the user
    complete: bool = True  # False: only the first frames
    drive: KittiDrive | None = None  # None: a video, or a folder of images

    def key(self, **settings: Any) -> str:
        """Return a hash of the source and of the settings of a run."""
        stat = self.path.stat()
        camera = [self.camera.K.tolist(), self.camera.size, self.camera.height_m, self.camera.horizon, self.count]
        identity = [str(self.path.resolve()), stat.st_size, stat.st_mtime_ns, camera, self.fps, settings]
        return hashlib.sha256(json.dumps(identity, default=str).encode()).hexdigest()[:16]


def open_source(
    path: Path,
    cameras: Sequence[int],
    lens: Lens,
    clock: Clock,
    height_m: float | None = None,
    max_frames: int | None = None,
) -> Source:
    """Open a KITTI drive's folder, a folder of images, or a video.

    Args:
        path: file or folder.
        cameras: of a KITTI drive; the first one with images is used.
        lens: intrinsics, if it is not a KITTI drive.
        clock: times, if it is not a KITTI drive.
        height_m: of the camera over the road; None: from a KITTI drive's calibration, else unknown.
        max_frames: of a video or a folder of images, use only the first ones; None: all.
    Raises:
        InputError: it is none of them, lacks a calibration, or cannot be read.
    """
    drive = KittiDrive(path.resolve()) if path.is_dir() else None
    if drive and any(drive.images(camera) for camera in cameras):
        if lens != Lens() or clock != Clock() or max_frames:
            fix = "Remove --calib, --fov, --K, --distortion, --fps, --times and --max-frames"
            raise InputError("a KITTI drive has its own calibration, times and frames", path, fix)
        source = _open_drive(path, drive, cameras)
    elif drive and (drive.oxts or drive.scans):
        raise InputError(f"no images of camera {' or '.join(map(str, cameras))}", path, "Extract image_02 of the drive")
    else:
        source = _open_recording(path, lens, clock, max_frames)
    if height_m is not None:
        return replace(source, camera=replace(source.camera, height_m=height_m), height_known=True)
    if source.height_known:
        check_height(source.camera.height_m)
    return source


def _open_drive(path: Path, drive: KittiDrive, cameras: Sequence[int]) -> Source:
    number = drive.camera_number(cameras)
    assert number is not None
    camera, images = drive.camera(number), drive.images(number)

    def frames() -> Iterator[Frame]:
        for frame, image in images.items():
            try:
                yield Frame(frame, 0.0, read_image(image, size=camera.size))
            except DamagedFile:
                continue  # as stage ingest does with on_damaged: skip

    name = drive.folder.name.removesuffix("_sync")
    return Source(path, name, camera, True, frames, len(images), None, [], drive=drive)


def _open_recording(path: Path, lens: Lens, clock: Clock, max_frames: int | None) -> Source:
    recording, notes = open_recording(path, clock.fps, clock.times), []
    if recording.size[0] > recording.size[1]:
        sizes = f"images are taller than wide ({format_size(recording.size)} pixels): is it rotated by 90 degrees?"
        raise InputError(sizes, path, ROTATE)
    camera = pinhole(recording.size, calib=lens.calib, fov_deg=lens.fov_deg, K=lens.K)
    if lens.distortion:
        recording.straighten = undistortion(camera, lens.distortion)
    if not recording.has_times:
        notes.append(f"images have no times: assuming {DEFAULT_FPS:g} per second. Other? Pass --fps or --times")
        recording.set_rate(DEFAULT_FPS)
    horizon = find_horizon(recording.frames(), camera)
    if horizon is None:
        notes.append("horizon: not found, since too few images show a drive; assuming a level camera")
    else:
        notes.append(f"horizon: row {horizon:.0f} of {recording.size[0]}")
    count = min(max_frames, recording.count or max_frames) if max_frames else recording.count
    camera = replace(camera, horizon=horizon)

    def frames() -> Iterator[Frame]:
        return islice(recording.frames(), max_frames)

    fps = recording.fps or DEFAULT_FPS
    return Source(path, path.stem, camera, False, frames, count, fps, notes, complete=not max_frames)
