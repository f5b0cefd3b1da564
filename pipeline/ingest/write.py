"""Write the ingest file of a drive, data/ingest/<drive>.h5.

It has all data that later stages need, whatever the drive's dataset is. Row i of a dataset belongs
to the frame whose number is in row i of ``frame``. Where a frame lacks data, the row has a fill
value, and ``has_<name>`` is 0.
"""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from pipeline.base.errors import DamagedFile, InputError
from pipeline.base.store import DriveWriter
from pipeline.base.summary import Summary, split_doubts
from pipeline.camera.camera import camera_height
from pipeline.camera.classes import VOID
from pipeline.camera.images import resize_image, resize_nearest, to_units
from pipeline.ingest import validate
from pipeline.ingest.drive import LIMITS, Drive, load_dataset
from pipeline.ingest.ingest_file import UNITS, create_ingest
from pipeline.ingest.packets import COLUMNS
from pipeline.ingest.settings import Ingest, Reading
from pipeline.ingest.stored_camera import write_camera


class _Map(NamedTuple):
    """How to store a dataset that has a value for each pixel of a frame."""

    missing: np.ndarray  # fill value of a pixel
    resize: Callable[..., np.ndarray]


MAPS = {
    "image": _Map(np.zeros(3, np.uint8), resize_image),
    "depth": _Map(np.array(0, np.uint16), resize_nearest),
    "cls": _Map(np.array(VOID, np.uint8), resize_nearest),
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
    numbers of frames, images, scans and so on, the median step ``step_s`` between frames,
    ``counts``, a text about them, and ``doubts``, a list of texts. Raises InputError if the drive
    has no frames or is not valid, see pipeline/ingest/validate.py. After the last frame, raises a
    DamagedFile that lists all damaged files or, if ``ingest.on_damaged`` is skip, InputError if all
    files of a kind are damaged.
    """
    validate.check_drive(drive)
    values = validate.check_values(drive.values)
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
    with create_ingest(path, drive=name, params=params) as file:
        # Maps that the file has so far. It always has images.
        written = {"image"}
        for frame in validate.check_frames(drive.frames()):
            damaged = frame.read_fields()
            faults += damaged.values()
            first_fault = damaged | first_fault
            validate.check_fields(frame, camera)
            depth = None if frame.depth_m is None else to_units(frame.depth_m)
            maps = {"image": frame.image, "depth": depth, "cls": frame.cls}
            for key, pixels in maps.items():
                missing, resize = MAPS[key]
                content = np.broadcast_to(missing, (*size, *missing.shape))
                # With the first depth or classes, earlier frames get the fill value.
                if pixels is not None and key not in written:
                    written.add(key)
                    for _ in rows:
                        file.append(key, content[None], UNITS[key])
                if pixels is not None:
                    content = resize(crop.cut_out(pixels), size)
                if key in written:
                    file.append(key, content[None], UNITS[key])

            scan = np.zeros((0, 4), np.float32) if frame.scan is None else frame.scan
            file.append("lidar", scan, UNITS["lidar"], "lidar_ptr")

            has = {key: pixels is not None for key, pixels in maps.items()}
            has["lidar"] = len(scan) > 0
            rows.append(_Row(int(frame.number), float(frame.time_s), len(scan), has))
            if advance:
                advance(1)
        if faults and settings.on_damaged != "skip":
            raise _list_damage(faults)
        if not rows:
            raise InputError("drive has no frames", name)

        number = np.array([row.number for row in rows], np.int32)
        time_s = np.array([row.time_s for row in rows])
        time_s -= time_s[0]
        step_s = validate.check_steps(time_s)
        notes = validate.note_gaps(number, time_s)
        notes += validate.doubt_gaps(number, time_s)
        notes += validate.note_unmatched(values, drive.values, number.tolist())
        file.put("frame", number)
        file.put("time_s", time_s, UNITS["time_s"])
        steered = _put_values(file, values, number.tolist())
        write_camera(file, camera.cropped(crop).scaled(size))
        file.put_pointers("lidar_ptr", [row.points for row in rows], UNITS["lidar_ptr"])
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
    drive.notes += notes
    if faults:
        drive.notes.append(f"{len(faults)} damaged files left out")

    texts = [f"{counts[key]} {text}" for key, text in COUNTS.items() if counts[key]]
    facts, doubts = split_doubts(drive.notes)
    text = "".join(f", {text}" for text in texts + facts)
    return {
        "frames": len(rows),
        **counts,
        "step_s": step_s,
        "counts": text,
        "doubts": doubts,
    }


def _list_damage(faults: list[DamagedFile]) -> DamagedFile:
    """Return the exception for a drive with damaged files."""
    problem = "; ".join(f"{fault.where}: {fault.problem}" for fault in faults)
    fix = "Copy or extract them again, or set ingest.on_damaged: skip to leave them out"
    return DamagedFile(problem, f"{len(faults)} damaged files", fix)


def _put_values(
    file: DriveWriter, values: Mapping[str, Mapping[int, Any]], numbers: list[int]
) -> int:
    """Write the values of the frames with these numbers. Return the number of steering angles."""
    steered = 0
    for name in LIMITS:
        by_number = values.get(name)
        if not by_number:
            continue
        unknown = np.full(len(COLUMNS), np.nan) if name == "oxts" else np.nan
        column = np.array([by_number.get(number, unknown) for number in numbers])
        if name != "steering_rad":
            file.put(name, column, UNITS[name])
            continue
        is_known = np.isfinite(column)
        file.put(name, np.where(is_known, column, 0.0), UNITS[name])
        file.put("has_steering", is_known.astype(np.uint8))
        steered = int(is_known.sum())
    return steered
