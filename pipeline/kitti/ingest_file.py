"""Write the ingest file, data/ingest/<drive>.h5: everything that later stages need of a raw drive.

Each row belongs to one of KITTI's frame numbers. Missing data has the fill value, and ``has_<name>`` is 0.
"""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from pipeline.base.errors import DamagedFile, InputError, error_context
from pipeline.base.runner import Summary
from pipeline.base.store import DriveWriter
from pipeline.camera.camera import write_camera
from pipeline.camera.classes import VOID
from pipeline.camera.images import DEPTH_UNITS_PER_M, Size, read_classes, read_depth, read_image
from pipeline.kitti import oxts, steering_file
from pipeline.kitti.raw import RawDrive, read_scan
from pipeline.settings.ingest import Ingest

Rows = Iterable[tuple[int, np.ndarray]]
"""Row index and array, for the frames that have one."""


class Pixels(NamedTuple):
    """A dataset [F,H,W,…] of pixels: reader of a raw file, channels, dtype, unit, fill value of absent frames."""

    read: Callable[..., np.ndarray]  # of path, size, new_size and crop
    channels: tuple[int, ...]
    dtype: type
    unit: str
    absent: int


PIXELS = {
    "image": Pixels(read_image, (3,), np.uint8, "RGB", 0),
    "depth": Pixels(read_depth, (), np.uint16, f"1/{DEPTH_UNITS_PER_M} m, 0 = none", 0),
    "cls": Pixels(read_classes, (), np.uint8, f"trainId, {VOID} = void", VOID),
}


def ingest(path: Path, *, drive: str, folder: Path, attributes: dict[str, str], settings: Ingest) -> Summary:
    """Write the frames of a drive: those with an oxts packet or, in a drive without oxts, those with an image."""
    raw, params = RawDrive(folder), {"ingest": settings.model_dump(exclude={"drives"})}
    scans = raw.scans if settings.lidar else {}
    number = raw.camera_number(settings.cameras)
    camera = None if number is None else raw.camera(number)
    if scans and (camera is None or camera.T_cam_velo is None):
        problem = "drive has scans, but calib_cam_to_cam.txt or calib_velo_to_cam.txt is missing"
        raise InputError(problem, raw.calibration, "Extract the date's calibration archive, or set ingest.lidar: false")
    images = {} if number is None else {"image": raw.images(number), "depth": raw.truth_depth, "cls": raw.truth_cls}
    images = {name: files for name, files in images.items() if files}
    reader = TolerantReader(tolerant=settings.on_damaged == "skip")

    numbers, times = raw.timeline(number)
    packets = dict(reader.arrays("oxts", oxts.read_row, raw.oxts, numbers))
    if not packets and (raw.oxts or not numbers or raw.oxts_times.parent.is_dir()):
        fix = "Extract it. Only if labels come from another labels.source: remove the empty folder"
        raise InputError("drive has no oxts packets", raw.oxts_times.parent, fix)
    # Lines of timestamps.txt correspond to existing files, including damaged ones.
    rows = list(packets or range(len(numbers)))
    frames, time_s = [numbers[row] for row in rows], oxts.read_times(times, numbers)[rows]
    with DriveWriter(path, stage="ingest", drive=drive, params=params) as file:
        file.attrs |= attributes
        counts = {"frames": len(frames), "oxts": len(packets), "steering": 0}
        file.attrs["camera"] = -1 if number is None else number
        put_motion(file, np.array(frames, np.int32), time_s, np.array(list(packets.values())) if packets else None)
        if raw.steering:
            counts["steering"] = put_steering(file, frames, steering_file.read(raw.steering))
        if camera:
            crop = camera.crop_to(settings.image_size)
            write_camera(file, camera.cropped(crop).scaled(settings.image_size))
        for name, pixels in PIXELS.items():
            arrays = None
            if camera and name in images:
                read = partial(pixels.read, size=camera.size, new_size=settings.image_size, crop=crop)
                arrays = reader.arrays(name, read, images[name], frames)
            counts[name] = put_pixels(file, name, len(frames), settings.image_size, arrays)
        counts["lidar"] = put_scans(file, len(frames), reader.arrays("lidar", read_scan, scans, frames))
    left_out = (set(images.get("image", {})) | set(scans)) - set(numbers)
    return counts | {"camera": number, "left_out": len(left_out), "damaged": dict(reader.damaged)}


def describe(summary: Summary) -> str:
    """Return the text for a drive's line in the log."""
    text = "{frames} frames, {image} images, {lidar} scans".format_map(summary)
    if summary["image"]:
        text += f", camera {summary['camera']}"
    if summary["depth"] or summary["cls"]:
        text += ", ground truth: {depth} depth, {cls} classes".format_map(summary)
    if summary["steering"]:
        text += f", {summary['steering']} steering angles"
    if summary["left_out"]:
        text += f", {summary['left_out']} without an {'oxts packet' if summary['oxts'] else 'image'} left out"
    for kind, number in summary["damaged"].items():
        text += f", {number} damaged {kind} left out"
    return text


def put_motion(file: DriveWriter, frame: np.ndarray, time_s: np.ndarray, oxts: np.ndarray | None) -> None:
    """Write frame numbers [F], seconds since the drive's first frame [F] and packets [F,30], if any. Comes first."""
    file.put("frame", np.asarray(frame, np.int32))
    file.put("time_s", time_s, "s")
    if oxts is not None:
        file.put("oxts", oxts, "as KITTI's oxts/dataformat.txt")


def put_steering(file: DriveWriter, frames: Iterable[int], steering_rad: Mapping[int, float]) -> int:
    """Write recorded steering angles by frame number and ``has_steering`` [F]; return the number of angles."""
    recorded = [steering_rad.get(frame) for frame in frames]
    file.put("steering_rad", np.array([angle or 0.0 for angle in recorded]), "rad, left positive")
    file.put("has_steering", np.array([angle is not None for angle in recorded], np.uint8))
    return sum(angle is not None for angle in recorded)


def put_pixels(file: DriveWriter, name: str, frames: int, size: Size, rows: Rows | None) -> int:
    """Write dataset `name` of :data:`PIXELS` and ``has_<name>`` [F]; return the number of rows.

    With `rows` None the dataset is left out, except for images, whose size later stages read.
    """
    pixels = PIXELS[name]
    has = np.zeros(frames, np.uint8)
    if rows is not None or name == "image":
        file.blank(name, (frames, *size, *pixels.channels), pixels.dtype, pixels.unit, value=pixels.absent)
    for index, array in rows or ():
        file.fill(name, index, array)
        has[index] = 1
    file.put(f"has_{name}", has)
    return int(has.sum())


def put_scans(file: DriveWriter, frames: int, rows: Rows) -> int:
    """Write LiDAR scans [P,4] and ``has_lidar`` [F]; return the number of scans."""
    points = np.zeros(frames, np.int64)
    file.append("lidar", np.zeros((0, 4), np.float32), "m, m, m, reflectance", "lidar_ptr")
    for index, scan in rows:
        file.append("lidar", scan)
        points[index] = len(scan)
    file.put_pointers("lidar_ptr", points, "rows of lidar")
    file.put("has_lidar", (points > 0).astype(np.uint8))
    return int(np.count_nonzero(points))


class TolerantReader:
    """Read files of single frames. A damaged file is an error or, if `tolerant`, skipped and counted by kind."""

    def __init__(self, tolerant: bool) -> None:
        self._tolerant = tolerant
        self.damaged: Counter[str] = Counter()

    def arrays(
        self, kind: str, read: Callable[[Path], np.ndarray], files: Mapping[int, Path], frames: Sequence[int]
    ) -> Iterator[tuple[int, np.ndarray]]:
        """Yield (position in `frames`, array) for each of `frames` with an intact file of this `kind`.

        Raises DamagedFile unless damaged files are tolerated.
        """
        for index, frame in enumerate(frames):
            try:
                with error_context(fix="Extract it again, or set ingest.on_damaged: skip to leave it out"):
                    array = read(files[frame]) if frame in files else None
            except DamagedFile:
                if not self._tolerant:
                    raise
                self.damaged[kind] += 1
                array = None
            if array is not None:
                yield index, array
