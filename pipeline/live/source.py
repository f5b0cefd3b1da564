"""Sources of frames: a KITTI drive, a folder of images or a video."""

import time
from collections.abc import Generator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np

from pipeline import label
from pipeline.base.errors import DamagedFile, InputError
from pipeline.camera.footage import open_footage
from pipeline.camera.images import Size, crop_to, read_image
from pipeline.camera.intrinsics import intrinsics
from pipeline.kitti import oxts
from pipeline.kitti.raw import RawDrive, read_scan
from pipeline.live.frame_state import FrameState
from pipeline.train.windows import Car

DEFAULT_FPS = 10.0  # KITTI's
MIN_SIDE = 16  # px; nothing can be recognised in smaller images


@dataclass
class Source:
    """A camera and its frames."""

    name: str  # of the drive; random draws depend on it
    size: Size  # (H, W) of the images
    K: np.ndarray  # [3,3] for that size
    frames: Generator[FrameState]
    count: int | None  # number of frames, if known
    fps: float
    T_cam_velo: np.ndarray | None = None  # [4,4]; None without LiDAR calibration
    has_scans: bool = False
    notes: list[str] = field(default_factory=list)  # for the user; grows while frames are read


class Lens(NamedTuple):
    """One of three ways to give a camera's intrinsics: see :func:`pipeline.camera.intrinsics.intrinsics`."""

    calib: Path | None = None
    fov_deg: float | None = None
    K: str | None = None


def open_source(path: Path, cameras: Sequence[int], lens: Lens, aspect: Size, scans: bool, car: Car) -> Source:
    """Open a KITTI drive's folder, a folder of images, or a video.

    Args:
        path: file or folder.
        cameras: of a KITTI drive; the first one with images is used.
        lens: intrinsics, if it is not a KITTI drive.
        aspect: (H, W) of the training images in any unit; images are cropped as by stage ingest.
        scans: whether to read the LiDAR scans of a KITTI drive.
        car: for the ground truth of a KITTI drive.
    Raises:
        InputError: it is none of them, lacks a calibration, or cannot be read.
    """
    drive = RawDrive(path.resolve())
    if any(drive.images(camera) for camera in cameras):
        if lens != Lens():
            raise InputError("a KITTI drive has its own calibration", path, "Remove --calib, --fov and --K")
        source = _open_drive(drive, cameras, aspect, scans, car)
    elif drive.oxts or drive.scans:
        wanted = " or ".join(map(str, cameras))
        raise InputError(f"no images of camera {wanted}", path, "Extract image_02 of the drive")
    else:
        source = _open_footage(path, lens, aspect)
    if min(source.size) < MIN_SIDE:
        height, width = source.size
        raise InputError(f"images are too small (got {width} x {height} px after cropping, at least {MIN_SIDE})", path)
    return source


def _open_drive(drive: RawDrive, cameras: Sequence[int], aspect: Size, scans: bool, car: Car) -> Source:
    camera = drive.camera(cameras)
    assert camera is not None  # since it has images
    crop = crop_to(camera.size, aspect, camera.K)
    images = drive.images(camera.number)
    stamped, stamps = drive.timeline(camera.number)
    numbers = [number for number in images if number in stamped]
    if not numbers:
        raise InputError("no image has an oxts packet of the same number", drive.folder, "Extract the drive again")
    notes = [] if stamps.is_file() else [f"{stamps} is missing: assuming {DEFAULT_FPS:g} frames per second"]
    seconds = (np.array(stamped) - stamped[0]) / DEFAULT_FPS if notes else oxts.read_times(stamps, stamped)
    time_s = dict(zip(stamped, seconds.tolist(), strict=True))

    def frames() -> Generator[FrameState]:
        for number in numbers:
            frame = FrameState(number, time_s[number], started_s=time.perf_counter())
            try:
                frame.source_image = read_image(images[number], camera.size, crop.size, crop)
                frame.scan = read_scan(drive.scans[number]) if scans and number in drive.scans else None
                frame.driven_rad = _driven_angle(drive.oxts, number, car)
            except DamagedFile as error:
                notes.append(f"skipped: {error}")
                continue
            yield frame

    fps = (len(time_s) - 1) / seconds[-1] if len(time_s) > 1 else DEFAULT_FPS
    return Source(
        name=drive.folder.name.removesuffix("_sync"),
        size=crop.size,
        K=crop.K(camera.K),
        frames=frames(),
        count=len(numbers),
        fps=float(fps),
        T_cam_velo=camera.T_cam_velo,
        has_scans=bool(drive.scans) and camera.T_cam_velo is not None,
        notes=notes,
    )


def _driven_angle(packets: Mapping[int, Path], number: int, car: Car) -> float | None:
    """Return the steering label of a frame; None without an oxts packet or below the minimum speed."""
    if number not in packets:
        return None
    row = oxts.read_row(packets[number])
    steering_rad, valid = label.steering_labels(row[[oxts.WU]], row[[oxts.VF]], **vars(car), standstill="invalid")
    return float(steering_rad[0]) if valid[0] else None


def _open_footage(path: Path, lens: Lens, aspect: Size) -> Source:
    footage = open_footage(path)
    K = intrinsics(footage.size, **lens._asdict())
    crop = crop_to(footage.size, aspect, K)

    def frames() -> Generator[FrameState]:
        started_s = time.perf_counter()
        for number, time_s, image in footage.frames():
            seconds = number / DEFAULT_FPS if time_s is None else time_s
            yield FrameState(number, seconds, source_image=crop.pixels(image), started_s=started_s)
            started_s = time.perf_counter()

    return Source(path.stem, crop.size, crop.K(K), frames(), footage.count, footage.fps or DEFAULT_FPS)
