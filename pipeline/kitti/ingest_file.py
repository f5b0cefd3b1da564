"""Write the ingest file, data/ingest/<drive>.h5: everything that later stages need of a recording.

Each row belongs to a frame number. Missing data has the fill value, and ``has_<name>`` is 0.
"""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from pipeline.base.errors import InputError
from pipeline.base.runner import Summary
from pipeline.base.store import DriveWriter
from pipeline.camera.camera import Camera, Frame, write_camera
from pipeline.camera.classes import VOID
from pipeline.camera.images import DEPTH_UNITS_PER_M, Crop, Size, nearest, resized, to_units
from pipeline.settings.ingest import Reading


class Pixels(NamedTuple):
    """A dataset [F,H,W,…] of pixels: channels, dtype, unit, and the fill value of frames without it."""

    channels: tuple[int, ...]
    dtype: type
    unit: str
    absent: int


PIXELS = {
    "image": Pixels((3,), np.uint8, "RGB", 0),
    "depth": Pixels((), np.uint16, f"1/{DEPTH_UNITS_PER_M} m, 0 = none", 0),
    "cls": Pixels((), np.uint8, f"trainId, {VOID} = void", VOID),
}


def ingest_drive(
    frames: Iterable[Frame],
    path: Path,
    *,
    drive: str,
    camera: Camera | None,
    settings: Reading,
    truth: Sequence[str] = (),
    oxts: Mapping[int, np.ndarray] | None = None,
    steering_rad: Mapping[int, float] | None = None,
    attributes: Mapping[str, Any] | None = None,
) -> Summary:
    """Write the ingest file of a recording and return the number of frames, images, scans, …

    Args:
        frames: in order, with complete images, depth and classes of the camera's size; read once.
        path: of the file.
        drive: name of the recording.
        camera: of complete images; None: a recording without images and scans.
        settings: stored in the file. Images are cropped around the horizon and resized to its ``image_size``.
        truth: datasets of ground truth that the file has, of "depth" and "cls".
        oxts: frame number → packet [30]; if given, of each frame.
        steering_rad: frame number → recorded angle of the front wheels.
        attributes: stored in the file.

    Raises InputError if there are no frames.
    """
    size = settings.image_size
    crop = camera.crop_to(size) if camera else None
    params = {"ingest": settings.model_dump(mode="json")}
    numbers: list[int] = []
    times_s: list[float] = []
    has: dict[str, list[bool]] = {name: [] for name in PIXELS}
    points: list[int] = []
    with DriveWriter(path, stage="ingest", drive=drive, params=params) as file:
        file.attrs |= attributes or {}
        for frame in frames:
            numbers.append(frame.number)
            times_s.append(frame.time_s)
            depth = None if frame.depth_m is None else to_units(frame.depth_m)
            for name, pixels in {"image": frame.image, "depth": depth, "cls": frame.cls}.items():
                has[name].append(pixels is not None)
                if name == "image" or name in truth:
                    file.append(name, _row(name, pixels, crop, size)[None], PIXELS[name].unit)
            scan = np.zeros((0, 4), np.float32) if frame.scan is None else frame.scan
            file.append("lidar", scan, "m, m, m, reflectance", "lidar_ptr")
            points.append(len(scan))
        if not numbers:
            raise InputError("recording has no frames", drive)
        _put_drive(file, numbers, times_s, oxts, steering_rad)
        if camera and crop:
            write_camera(file, camera.cropped(crop).scaled(size))
        file.put_pointers("lidar_ptr", points, "rows of lidar")
        has["lidar"] = [count > 0 for count in points]
        for name, present in has.items():
            file.put(f"has_{name}", np.array(present, np.uint8))
    counts = {name: sum(present) for name, present in has.items()}
    steering = sum(number in (steering_rad or {}) for number in numbers)
    return {"frames": len(numbers), "oxts": len(numbers) if oxts else 0, "steering": steering, **counts}


def _row(name: str, pixels: np.ndarray | None, crop: Crop | None, size: Size) -> np.ndarray:
    """Return the row of dataset `name` [H,W,…] for the pixels of a complete image, if there are any."""
    if pixels is None or crop is None:
        return np.full((*size, *PIXELS[name].channels), PIXELS[name].absent, PIXELS[name].dtype)
    return (resized if name == "image" else nearest)(crop.pixels(pixels), size)


def _put_drive(
    file: DriveWriter,
    numbers: Sequence[int],
    times_s: Sequence[float],
    oxts: Mapping[int, np.ndarray] | None,
    steering_rad: Mapping[int, float] | None,
) -> None:
    """Write frame numbers, times, packets and angles of all frames."""
    file.put("frame", np.array(numbers, np.int32))
    file.put("time_s", np.array(times_s), "s")
    if oxts:
        file.put("oxts", np.array([oxts[number] for number in numbers]), "as KITTI's oxts/dataformat.txt")
    if steering_rad:
        angles = [steering_rad.get(number) for number in numbers]
        file.put("steering_rad", np.array([angle or 0.0 for angle in angles]), "rad, left positive")
        file.put("has_steering", np.array([angle is not None for angle in angles], np.uint8))
