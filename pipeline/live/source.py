"""Sources of frames: a KITTI drive, a folder of images or a video."""

import os
import time
from collections.abc import Generator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from pipeline.base.errors import DamagedFile, InputError
from pipeline.camera.camera import Camera
from pipeline.camera.images import Crop, Size, format_size, read_image, resized
from pipeline.camera.mount import check_height
from pipeline.kitti import oxts
from pipeline.kitti.raw import KittiDrive, read_scan
from pipeline.labels.label import Car
from pipeline.live.chain import FrameState
from pipeline.live.truth import UNKNOWN, Driven, Truth, of_drive
from pipeline.video.horizon import find_horizon
from pipeline.video.lens import pinhole, undistortion
from pipeline.video.recording import open_recording

DEFAULT_FPS = 10.0  # KITTI's
ROTATE = "Rotate it: ffmpeg -i in.mp4 -vf transpose=1 out.mp4 (or transpose=2)"
MAX_WIDTH = 1280  # px, of the overlay
MIN_SIDE = 16  # px; nothing can be recognised in smaller images


@dataclass
class Source:
    """A camera and its frames."""

    path: Path
    name: str  # of the drive; random draws depend on it
    camera: Camera  # of complete images; height_m is KITTI's unless height_known
    crop: Crop  # the part of the images that the encoder gets
    frames: Generator[FrameState]
    count: int | None  # number of frames, if known
    fps: float
    has_scans: bool = False
    truth: str = ""  # where driven_rad and driven_mps are from; empty if unknown
    notes: list[str] = field(default_factory=list)  # for the user; grows while frames are read
    slope: float = 0.0  # of the road, metres down per metre ahead of the camera
    height_known: bool = False  # of the camera over the road
    distortion: str = ""  # of the lens; frames are without it

    @property
    def cropped(self) -> Camera:
        """The camera of the encoder's part of the images."""
        return self.camera.cropped(self.crop)

    @property
    def shown(self) -> Size:
        """(H, W) of frames in the overlay."""
        return _shown_size(self.camera.size)


class Lens(NamedTuple):
    """One of three ways to give intrinsics, see :func:`pipeline.camera.intrinsics.pinhole`; distortion of the lens."""

    calib: Path | None = None
    fov_deg: float | None = None
    K: str | None = None
    distortion: str | None = None  # see :func:`pipeline.camera.intrinsics.undistortion`


class Clock(NamedTuple):
    """One of two ways to give the images' times: images per second, or a file with a time in seconds per image."""

    fps: float | None = None
    times: Path | None = None


def open_source(
    path: Path,
    cameras: Sequence[int],
    lens: Lens,
    aspect: Size,
    scans: bool,
    car: Car,
    clock: Clock = Clock(),
    height_m: float | None = None,
    level: bool = True,
    truth: Truth | None = None,
) -> Source:
    """Open a KITTI drive's folder, a folder of images, or a video.

    Args:
        path: file or folder.
        cameras: of a KITTI drive; the first one with images is used.
        lens: intrinsics, if it is not a KITTI drive.
        aspect: (H, W) of the training images in any unit; the encoder gets this part, as from stage ingest.
        scans: whether to read the LiDAR scans of a KITTI drive.
        car: for the ground truth of a KITTI drive.
        clock: times, if it is not a KITTI drive.
        height_m: of the camera over the road; None: from a KITTI drive's calibration, else unknown.
        level: crop around the optical axis, as by stage ingest; False: around the horizon, which is searched for.
        truth: what was driven; None: from a KITTI drive's oxts or steering.csv, else unknown.
    Raises:
        InputError: it is none of them, lacks a calibration, or cannot be read.
    """
    drive = KittiDrive(path.resolve()) if path.is_dir() else None
    if drive and any(drive.images(camera) for camera in cameras):
        if lens != Lens() or clock != Clock():
            fix = "Remove --calib, --fov, --K, --distortion, --fps and --times"
            raise InputError("a KITTI drive has its own calibration and times", path, fix)
        source = _open_drive(path, drive, cameras, aspect, scans, car, truth)
    elif drive and (drive.oxts or drive.scans):
        wanted = " or ".join(map(str, cameras))
        raise InputError(f"no images of camera {wanted}", path, "Extract image_02 of the drive")
    else:
        source = _open_footage(path, lens, aspect, clock, level, truth or UNKNOWN)
    if height_m is not None:
        source.camera, source.height_known = replace(source.camera, height_m=height_m), True
    elif source.height_known:
        check_height(source.camera.height_m)
    if min(source.crop.size) < MIN_SIDE:
        height, width = source.crop.size
        raise InputError(f"images are too small (got {width} x {height} px after cropping, at least {MIN_SIDE})", path)
    return source


def _open_drive(
    path: Path, drive: KittiDrive, cameras: Sequence[int], aspect: Size, scans: bool, car: Car, given: Truth | None
) -> Source:
    camera_number = drive.camera_number(cameras)
    assert camera_number is not None  # since it has images
    camera = drive.camera(camera_number)
    crop = camera.crop_to(aspect)
    images = drive.images(camera_number)
    stamped, stamps = drive.timeline(camera_number)
    numbers = [number for number in images if number in stamped]
    if not numbers:
        raise InputError("no image has an oxts packet of the same number", drive.folder, "Extract the drive again")
    notes = [] if stamps.is_file() else [f"{stamps} is missing: assuming {DEFAULT_FPS:g} frames per second"]
    seconds = (np.array(stamped) - stamped[0]) / DEFAULT_FPS if notes else oxts.read_times(stamps, stamped)
    time_s = dict(zip(stamped, seconds.tolist(), strict=True))
    truth = given or of_drive(drive, car, notes)

    def frames() -> Generator[FrameState]:
        for number in numbers:
            started_s = time.perf_counter()
            try:
                image = read_image(images[number], camera.size)
                scan = read_scan(drive.scans[number]) if scans and number in drive.scans else None
            except DamagedFile as error:
                notes.append(f"skipped: {error}")
                continue
            driven = truth.at(number, time_s[number])
            frame = _frame(number, time_s[number], image, crop, driven, started_s)
            frame.scan = scan
            yield frame

    fps = (len(time_s) - 1) / seconds[-1] if len(time_s) > 1 else DEFAULT_FPS
    return Source(
        path=path,
        name=drive.folder.name.removesuffix("_sync"),
        camera=camera,
        crop=crop,
        frames=frames(),
        count=len(numbers),
        fps=float(fps),
        has_scans=bool(drive.scans) and camera.T_cam_velo is not None,
        truth=truth.name,
        notes=notes,
        height_known=True,  # KITTI's without a LiDAR calibration
    )


def _shown_size(size: Size) -> Size:
    """Return the size of images (H, W) after reduction to MAX_WIDTH, even for 4:2:0."""
    scale = min(1.0, MAX_WIDTH / size[1])
    return max(2, int(size[0] * scale) // 2 * 2), max(2, int(size[1] * scale) // 2 * 2)


def _frame(number: int, time_s: float, image: np.ndarray, crop: Crop, driven: Driven, started_s: float) -> FrameState:
    """Return a frame of an image [H,W,3]: the encoder's part of it, and the image at the overlay's size."""
    shown = resized(image, _shown_size((image.shape[0], image.shape[1])))
    part = crop.pixels(image)
    return FrameState(number, time_s, part, source_image=shown, started_s=started_s, **driven._asdict())


def _open_footage(path: Path, lens: Lens, aspect: Size, clock: Clock, level: bool, truth: Truth) -> Source:
    footage = open_recording(path, clock.fps, clock.times)
    if footage.size[0] > footage.size[1]:
        sizes = f"images are taller than wide ({format_size(footage.size)} pixels): is it rotated by 90 degrees?"
        raise InputError(sizes, path, ROTATE)
    camera = pinhole(footage.size, calib=lens.calib, fov_deg=lens.fov_deg, K=lens.K)
    if lens.distortion:
        footage.straighten = undistortion(camera, lens.distortion)
    notes, horizon = [], None
    if not footage.has_times:
        notes.append(f"images have no times: assuming {DEFAULT_FPS:g} per second. Other? Pass --fps or --times")
        footage.set_rate(DEFAULT_FPS)
    if not level and (horizon := find_horizon(footage.frames(), camera)) is None:
        notes.append("horizon: not found, since too few images show a drive; assuming a level camera")
    camera = replace(camera, horizon=horizon)
    crop = camera.crop_to(aspect)

    def frames() -> Generator[FrameState]:
        started_s = time.perf_counter()
        for frame in footage.frames():
            assert frame.image is not None
            driven = truth.at(frame.number, frame.time_s)
            yield _frame(frame.number, frame.time_s, frame.image, crop, driven, started_s)
            started_s = time.perf_counter()

    fps = footage.fps or DEFAULT_FPS
    name = os.fsencode(path.stem).decode(errors="backslashreplace")
    source = Source(path, name, camera, crop, frames(), footage.count, fps, truth=truth.name, notes=notes)
    source.distortion = lens.distortion or ""
    if crop.size != footage.size:
        rows, columns = crop
        part = f"rows {rows.start} to {rows.stop} and columns {columns.start} to {columns.stop}"
        notes.append(f"images are cropped to {part}, the shape of the training images")
    if horizon is not None:
        source.slope = (horizon - camera.K[1, 2]) / camera.K[1, 1]
        notes.append(f"horizon: row {horizon:.0f} of {footage.size[0]}")
    return source
