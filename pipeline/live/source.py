"""What a live chain sees: a KITTI drive, a folder of images or a video, one frame at a time."""

import time
from collections.abc import Generator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from pipeline import label
from pipeline.base.errors import DamagedFile, InputError
from pipeline.camera.footage import open_footage
from pipeline.camera.images import Size, read_image
from pipeline.camera.intrinsics import intrinsics
from pipeline.kitti import oxts
from pipeline.kitti.raw import RawDrive, read_scan
from pipeline.live.moment import Moment
from pipeline.live.view import View
from pipeline.train.windows import Car

FPS = 10.0  # where nothing says it; KITTI's


@dataclass
class Source:
    """Frames to come, and the camera that they are of."""

    view: View
    moments: Generator[Moment]
    count: int | None  # frames to come, where that is known
    fps: float
    notes: list[str] = field(default_factory=list)  # what a user is to know, as it is met


@dataclass(frozen=True)
class Lens:
    """How a user says a camera's intrinsics, one of them: see :func:`pipeline.camera.intrinsics.intrinsics`."""

    calib: Path | None = None
    fov_deg: float | None = None
    K: str | None = None


def open_source(path: Path, cameras: Sequence[int], lens: Lens, aspect: Size, scans: bool, car: Car) -> Source:
    """Open what a user names: a KITTI drive's folder, a folder of images, or a video.

    Args:
        cameras: of a KITTI drive, the first of them that has images.
        lens: of what is no KITTI drive.
        aspect: (H, W) in any unit: images of another shape are cut at top and bottom, or at the sides, around the
            optical axis, as a network has only seen this shape. A KITTI drive's stay whole.
        scans: whether the LiDAR scans of a KITTI drive are wanted.
        car: tells a KITTI drive's driven angles.
    Raises:
        InputError: it is none of them, is not calibrated, or cannot be read.
    """
    drive = RawDrive(path.resolve())
    if any(drive.images(camera) for camera in cameras):
        if lens != Lens():
            raise InputError(f"{path} is a KITTI drive with a calibration of its own: leave out --calib, --fov and --K")
        return _of_drive(drive, cameras, scans, car)
    if drive.oxts or drive.scans:
        raise InputError(f"{path} has no images of camera {' or '.join(map(str, cameras))}: extract image_02 as well")
    return _of_footage(path, lens, aspect)


def _of_drive(drive: RawDrive, cameras: Sequence[int], scans: bool, car: Car) -> Source:
    camera = drive.camera(cameras)
    assert camera is not None  # as it has images
    images = drive.images(camera.number)
    # As in stage ingest, where there are packets: frames are those that have one, at its time.
    numbers = [number for number in images if number in drive.oxts] if drive.oxts else list(images)
    if not numbers:
        raise InputError(f"{drive.folder}: no image has an oxts packet of its number: extract the drive again")
    stamps = drive.oxts_times if drive.oxts else drive.folder / f"image_{camera.number:02d}" / "timestamps.txt"
    of_file = list(drive.oxts) if drive.oxts else numbers
    notes = [] if stamps.is_file() else [f"{stamps} is missing: frames are taken to come {FPS:g} times a second"]
    seconds = (np.array(of_file) - of_file[0]) / FPS if notes else oxts.read_times(stamps, of_file)
    time_s = dict(zip(of_file, seconds.tolist(), strict=True))
    view = View(
        drive.folder.name.removesuffix("_sync"),
        camera.size,
        camera.K,
        camera.T_cam_velo,
        bool(drive.scans) and camera.T_cam_velo is not None,
    )
    source = Source(view, iter(()), len(numbers), _fps(list(time_s.values())), notes)  # type: ignore[arg-type]

    def moments() -> Generator[Moment]:
        for number in numbers:
            began_s = time.perf_counter()
            try:
                image = read_image(images[number], camera.size, camera.size)
                scan = read_scan(drive.scans[number]) if scans and number in drive.scans else None
                driven_rad = _driven(drive.oxts, number, car)
            except DamagedFile as error:
                notes.append(f"left out: {error}")
                continue
            yield Moment(number, time_s[number], image, began_s, scan, driven_rad)

    source.moments = moments()
    return source


def _driven(packets: Mapping[int, Path], number: int, car: Car) -> float | None:
    """Return the angle that a frame's oxts packet says; None where it says nothing."""
    if number not in packets:
        return None
    row = oxts.read_row(packets[number])
    yaw_rate_radps, speed_mps = row[[oxts.WU]], row[[oxts.VF]]
    steering_rad, valid = label.steering_labels(
        yaw_rate_radps, speed_mps, wheelbase_m=car.wheelbase_m, min_speed_mps=car.min_speed_mps, standstill="invalid"
    )
    return float(steering_rad[0]) if valid[0] else None


def _of_footage(path: Path, lens: Lens, aspect: Size) -> Source:
    footage = open_footage(path)
    K = intrinsics(footage.size, **vars(lens))
    rows, columns = _cut(footage.size, K, aspect)
    cut_K = K.copy()
    cut_K[0, 2] -= columns.start
    cut_K[1, 2] -= rows.start
    size = rows.stop - rows.start, columns.stop - columns.start

    def moments() -> Generator[Moment]:
        began_s = time.perf_counter()
        for number, time_s, image in footage.frames():
            yield Moment(
                number, number / FPS if time_s is None else time_s, np.ascontiguousarray(image[rows, columns]), began_s
            )
            began_s = time.perf_counter()

    return Source(View(path.stem, size, cut_K), moments(), footage.count, footage.fps or FPS)


def _cut(size: Size, K: np.ndarray, aspect: Size) -> tuple[slice, slice]:
    """Return the rows and columns of the largest part of an image that has this shape, around the optical axis."""
    height, width = size
    if height * aspect[1] > width * aspect[0]:
        return _around(K[1, 2], round(width * aspect[0] / aspect[1]), height), slice(0, width)
    return slice(0, height), _around(K[0, 2], round(height * aspect[1] / aspect[0]), width)


def _around(centre: float, length: int, whole: int) -> slice:
    start = min(max(round(centre + 0.5 - length / 2), 0), whole - length)
    return slice(start, start + length)


def _fps(time_s: Sequence[float]) -> float:
    return (len(time_s) - 1) / (time_s[-1] - time_s[0]) if len(time_s) > 1 else FPS
