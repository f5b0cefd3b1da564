"""Write the ingest file, data/ingest/<drive>.h5: everything that later stages need of a drive of
any dataset.

Each row belongs to a frame number. Missing data has the fill value, and ``has_<name>`` is 0.
"""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.base.errors import InputError, closest
from pipeline.base.runner import Summary
from pipeline.base.store import DriveWriter
from pipeline.camera.camera import Camera, Frame, camera_height, write_camera
from pipeline.camera.classes import VOID
from pipeline.camera.images import format_size, nearest, resized, to_units
from pipeline.ingest.drive import Drive, load
from pipeline.ingest.packets import recorded_motion
from pipeline.ingest.settings import Ingest, Reading

# Name → unit, value of missing pixels, how pixels are resized.
MAPS: dict[str, tuple[str, np.ndarray, Callable[..., np.ndarray]]] = {
    "image": ("RGB", np.zeros(3, np.uint8), resized),
    "depth": ("1/256 m, 0 = none", np.array(0, np.uint16), nearest),
    "cls": (f"trainId, {VOID} = void", np.array(VOID, np.uint8), nearest),
}
HAS = (*MAPS, "lidar")
# Of the values of a frame: unit, and the value of a frame without one. Of oxts, each frame has a
# packet.
VALUES: dict[str, tuple[str, float]] = {
    "oxts": ("as KITTI's oxts/dataformat.txt", np.nan),
    "steering_rad": ("rad, left positive", 0.0),
    "speed_mps": ("m/s, forward positive", np.nan),
    "left_mps": ("m/s, left positive", np.nan),
    "yaw_rate_radps": ("rad/s, left positive", np.nan),
}
COUNTS = {
    "image": "images",
    "lidar": "scans",
    "depth": "depth maps",
    "cls": "class maps",
    "steering": "steering angles",
}


def ingest_drive(
    path: Path, name: str, dataset: str, settings: Ingest, root: Path, reading: Reading
) -> Summary:
    """Write the file of drive `name` of a dataset below `root`, see pipeline/ingest/drive.py."""
    return write_drive(path, load(dataset).open_drive(name, settings, root), name, dataset, reading)


def write_drive(
    path: Path,
    drive: Drive,
    name: str,
    dataset: str,
    settings: Reading,
    advance: Callable[[int], object] | None = None,
) -> Summary:
    """Write a drive of `dataset`; `advance` is called with the number of frames that are done since
    the last call.

    Images are cropped around the horizon. Returns the counts of frames, images, scans, …, and
    ``counts``, a text. Raises InputError if there are no frames, pixels of another size than the
    camera's, or values with an unknown name.
    """
    _check_names(drive.values)
    camera, size = drive.camera, settings.image_size
    values = {**recorded_motion(drive.values.get("oxts", {})), **drive.values}
    crop = camera.crop_to(size) if camera else None
    params: dict[str, Any] = {
        "dataset": drive.dataset or dataset,
        "ingest": settings.model_dump(mode="json"),
    }
    if camera and camera.height_known and camera.height_m != camera_height(camera.T_cam_velo):
        params["camera_height_m"] = camera.height_m
    # number, time, points, and whether it has the HAS; maps
    rows, written = list[tuple[float, ...]](), {"image"}
    with DriveWriter(path, stage="ingest", drive=name, params=params) as file:
        for frame in drive.frames():
            _check_size(frame, camera)
            depth = None if frame.depth_m is None else to_units(frame.depth_m)
            maps = {"image": frame.image, "depth": depth, "cls": frame.cls}
            for key, pixels in maps.items():
                unit, fill, resize = MAPS[key]
                empty = np.broadcast_to(fill, (*size, *fill.shape))
                if pixels is not None and key not in written:  # the first depth or classes
                    written.add(key)
                    for _ in rows:
                        file.append(key, empty[None], unit)
                if key in written:
                    row = (
                        resize(crop.pixels(pixels), size) if pixels is not None and crop else empty
                    )
                    file.append(key, row[None], unit)
            scan = np.zeros((0, 4), np.float32) if frame.scan is None else frame.scan
            file.append("lidar", scan, "m, m, m, reflectance", "lidar_ptr")
            has = (pixels is not None for pixels in maps.values())
            rows.append((frame.number, frame.time_s, len(scan), *has, len(scan) > 0))
            if advance:
                advance(1)
        if not rows:
            raise InputError("drive has no frames", name)
        numbers, times_s, points, *present = zip(*rows, strict=True)
        file.put("frame", np.array(numbers, np.int32))
        file.put("time_s", np.array(times_s), "s")
        steered = np.isin(numbers, [*values.get("steering_rad", ())])
        for key, (unit, unknown) in VALUES.items():
            if of_frame := values.get(key):
                file.put(key, np.array([of_frame.get(number, unknown) for number in numbers]), unit)
                if key == "steering_rad":
                    file.put("has_steering", steered.astype(np.uint8))
        if camera and crop:
            write_camera(file, camera.cropped(crop).scaled(size))
        file.put_pointers("lidar_ptr", points, "rows of lidar")
        for key, of_frames in zip(HAS, present, strict=True):
            file.put(f"has_{key}", np.array(of_frames, np.uint8))
    counts = dict(zip(HAS, map(sum, present), strict=True)) | {"steering": int(steered.sum())}
    texts = [
        *(f"{counts[key]} {text}" for key, text in COUNTS.items() if counts[key]),
        *drive.notes,
    ]
    return {"frames": len(numbers)} | counts | {"counts": "".join(f", {text}" for text in texts)}


def _check_names(values: Mapping[str, Any]) -> None:
    """Raise InputError if values have a name that no file of stage ingest has: they would be
    lost.
    """
    for name in values:
        if name not in VALUES:
            raise InputError(
                f"Drive.values has the unknown name {name}: {closest(name, [*VALUES])}"
            )


def _check_size(frame: Frame, camera: Camera | None) -> None:
    """Raise InputError if pixels of a frame have another size than the camera, whose crop would cut
    them.
    """
    if camera is None:
        return
    for kind, pixels in (("image", frame.image), ("depth_m", frame.depth_m), ("cls", frame.cls)):
        if pixels is None or pixels.shape[:2] == camera.size:
            continue
        problem = f"{kind} of frame {frame.number} has {format_size(pixels.shape)} pixels"
        expected = f"expected {format_size(camera.size)}, the size of Drive.camera"
        fix = "Give the camera the size of the complete images, and K for this size"
        if pixels.shape[:2] == camera.size[::-1]:
            fix = f"Camera.size is (H, W), here ({pixels.shape[0]}, {pixels.shape[1]})"
        raise InputError(f"{problem}, {expected}", fix=fix)
