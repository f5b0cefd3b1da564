"""Write the ingest file of a drive, data/ingest/<drive>.h5.

It has all data that later stages need, whatever the drive's dataset is. Row i of a dataset belongs
to the frame whose number is in row i of ``frame``. Where a frame lacks data, the row has a fill
value, and ``has_<name>`` is 0.
"""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from pipeline.base.errors import DamagedFile, InputError, closest
from pipeline.base.store import DriveWriter
from pipeline.base.summary import Summary
from pipeline.camera.camera import Camera, Frame, camera_height, write_camera
from pipeline.camera.classes import VOID
from pipeline.camera.images import format_size, resize_image, resize_nearest, to_units
from pipeline.ingest.drive import Drive, load_dataset
from pipeline.ingest.packets import extract_motion
from pipeline.ingest.settings import Ingest, Reading


class _Map(NamedTuple):
    """How to store a dataset that has a value for each pixel of a frame."""

    unit: str
    missing: np.ndarray  # fill value of a pixel
    resize: Callable[..., np.ndarray]


class _Value(NamedTuple):
    """How to store a dataset that has a value, or a packet of values, for each frame."""

    unit: str
    missing: float  # fill value of a frame


MAPS = {
    "image": _Map("RGB", np.zeros(3, np.uint8), resize_image),
    "depth": _Map("1/256 m, 0 = none", np.array(0, np.uint16), resize_nearest),
    "cls": _Map(f"trainId, {VOID} = void", np.array(VOID, np.uint8), resize_nearest),
}
# Recorded values by name. In a drive with oxts, each frame has a packet, so there is no has_oxts.
VALUES = {
    "oxts": _Value("as KITTI's oxts/dataformat.txt", np.nan),
    "steering_rad": _Value("rad, left positive", 0.0),
    "speed_mps": _Value("m/s, forward positive", np.nan),
    "left_mps": _Value("m/s, left positive", np.nan),
    "yaw_rate_radps": _Value("rad/s, left positive", np.nan),
}
# Name of the data that a frame may lack → its field of Frame. For each name, the file has a dataset
# has_<name>.
HAS = {"image": "image", "depth": "depth_m", "cls": "cls", "lidar": "scan"}
# Name of a count → its word in the log.
COUNTS = {
    "image": "images",
    "lidar": "scans",
    "depth": "depth maps",
    "cls": "class maps",
    "steering": "steering angles",
}


class _Row(NamedTuple):
    """Facts of a frame that has been written."""

    number: int
    time_s: float
    points: int  # number of points in its scan
    has: dict[str, bool]  # name in HAS → whether the frame has the data


def ingest_drive(
    path: Path, name: str, dataset: str, settings: Ingest, root: Path, reading: Reading
) -> Summary:
    """Write the file of drive `name` of a dataset below `root`, see pipeline/ingest/drive.py."""
    drive = load_dataset(dataset).open_drive(name, settings, root)
    return write_drive(path, drive, name, dataset, reading)


def write_drive(
    path: Path,
    drive: Drive,
    name: str,
    dataset: str,
    settings: Reading,
    advance: Callable[[int], object] | None = None,
) -> Summary:
    """Write a drive of `dataset`, with images cropped around the horizon and resized.

    `advance` is called with the number of frames that were written since its last call. Returns the
    numbers of frames, images, scans and so on, and ``counts``, a text about them. Raises InputError
    if the drive has no frames, pixels of another size than the camera's, or values with an unknown
    name. After the last frame, raises a DamagedFile that lists all damaged files or, if
    ``ingest.on_damaged`` is skip, InputError if all files of a kind are damaged.
    """
    _check_names(drive.values)
    camera = drive.camera
    size = settings.image_size
    crop = camera.crop_to(size)
    params: dict[str, Any] = {
        "dataset": drive.dataset or dataset,
        "ingest": settings.model_dump(mode="json"),
    }
    # A height that was passed, and does not follow from the calibration, is a setting of the drive.
    if camera.height_known and camera.height_m != camera_height(camera.T_cam_velo):
        params["camera_height_m"] = camera.height_m
    # Between files, time may be missing, so that no log has one offset to all.
    if drive.recordings > 1:
        params["recordings"] = drive.recordings

    rows = list[_Row]()
    faults = [*drive.damaged]
    # Name of a field of Frame → the first damaged file.
    first_fault = dict[str, DamagedFile]()
    with DriveWriter(path, stage="ingest", drive=name, params=params) as file:
        # Maps that the file has so far. It always has images.
        written = {"image"}
        for frame in drive.frames():
            damaged = frame.read_fields()
            faults += damaged.values()
            first_fault = damaged | first_fault
            _check_size(frame, camera)
            depth = None if frame.depth_m is None else to_units(frame.depth_m)
            maps = {"image": frame.image, "depth": depth, "cls": frame.cls}
            for key, pixels in maps.items():
                unit, missing, resize = MAPS[key]
                content = np.broadcast_to(missing, (*size, *missing.shape))
                # With the first depth or classes, earlier frames get the fill value.
                if pixels is not None and key not in written:
                    written.add(key)
                    for _ in rows:
                        file.append(key, content[None], unit)
                if pixels is not None:
                    content = resize(crop.cut_out(pixels), size)
                if key in written:
                    file.append(key, content[None], unit)

            scan = np.zeros((0, 4), np.float32) if frame.scan is None else frame.scan
            file.append("lidar", scan, "m, m, m, reflectance", "lidar_ptr")

            has = {key: pixels is not None for key, pixels in maps.items()}
            has["lidar"] = len(scan) > 0
            rows.append(_Row(frame.number, frame.time_s, len(scan), has))
            if advance:
                advance(1)
        if faults and settings.on_damaged != "skip":
            raise _list_damage(faults)
        if not rows:
            raise InputError("drive has no frames", name)

        numbers = [row.number for row in rows]
        file.put("frame", np.array(numbers, np.int32))
        file.put("time_s", np.array([row.time_s for row in rows]), "s")
        steered = _put_values(file, drive.values, numbers)
        write_camera(file, camera.cropped(crop).scaled(size))
        file.put_pointers("lidar_ptr", [row.points for row in rows], "rows of lidar")
        counts = {}
        for key, field in HAS.items():
            present = np.array([row.has[key] for row in rows], np.uint8)
            file.put(f"has_{key}", present)
            counts[key] = int(present.sum())
            if field in first_fault and not counts[key]:
                fault = first_fault[field]
                problem = f"all {COUNTS[key]} of the drive are damaged: {fault.problem}"
                raise InputError(problem, fault.where)
    counts["steering"] = steered
    if faults:
        drive.notes.append(f"{len(faults)} damaged files left out")

    texts = [f"{counts[key]} {text}" for key, text in COUNTS.items() if counts[key]]
    text = "".join(f", {text}" for text in texts + drive.notes)
    return {"frames": len(rows), **counts, "counts": text}


def _list_damage(faults: list[DamagedFile]) -> DamagedFile:
    """Return the exception for a drive with damaged files."""
    problem = "; ".join(f"{fault.where}: {fault.problem}" for fault in faults)
    fix = "Copy or extract them again, or set ingest.on_damaged: skip to leave them out"
    return DamagedFile(problem, f"{len(faults)} damaged files", fix)


def _put_values(
    file: DriveWriter, values: Mapping[str, Mapping[int, Any]], numbers: list[int]
) -> int:
    """Write the values of the frames with these numbers. Return the number of steering angles."""
    motion = extract_motion(values.get("oxts", {}))
    values = {**motion, **values}
    has_steering = np.isin(numbers, [*values.get("steering_rad", ())])
    for key, (unit, missing) in VALUES.items():
        by_number = values.get(key)
        if by_number:
            column = np.array([by_number.get(number, missing) for number in numbers])
            file.put(key, column, unit)
            if key == "steering_rad":
                file.put("has_steering", has_steering.astype(np.uint8))
    return int(has_steering.sum())


def _check_names(values: Mapping[str, Any]) -> None:
    """Raise InputError for values with an unknown name, which would not be written."""
    for name in values:
        if name not in VALUES:
            problem = f"Drive.values has the unknown name {name}: {closest(name, [*VALUES])}"
            raise InputError(problem)


def _check_size(frame: Frame, camera: Camera) -> None:
    """Raise InputError if pixels of a frame have another size than the camera.

    The crop around the horizon is computed for the camera's size.
    """
    for kind, pixels in (("image", frame.image), ("depth_m", frame.depth_m), ("cls", frame.cls)):
        if pixels is None or pixels.shape[:2] == camera.size:
            continue
        problem = f"{kind} of frame {frame.number} has {format_size(pixels.shape)} pixels"
        expected = f"expected {format_size(camera.size)}, the size of Drive.camera"
        fix = "Give the camera the size (H, W) of the complete images, and K for this size"
        raise InputError(f"{problem}, {expected}", fix=fix)
