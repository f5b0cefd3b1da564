"""Write the ingest file, data/ingest/<drive>.h5: everything that later stages need of a raw drive.

Rows go by KITTI's frame numbers. What a frame lacks stays empty, and ``has_<name>`` is 0.
"""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from pipeline.base.errors import DamagedFile, error_context
from pipeline.base.store import DriveWriter
from pipeline.camera.classes import VOID
from pipeline.camera.images import DEPTH_UNITS_PER_M, Size, read_classes, read_depth, read_image

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


def put_motion(file: DriveWriter, frame: np.ndarray, time_s: np.ndarray, oxts: np.ndarray | None) -> None:
    """Write frame numbers [F], seconds since the drive's first frame [F] and packets [F,30], if any. Comes first."""
    file.put("frame", np.asarray(frame, np.int32))
    file.put("time_s", time_s, "s")
    if oxts is not None:
        file.put("oxts", oxts, "as KITTI's oxts/dataformat.txt")


def put_steering(file: DriveWriter, frames: Iterable[int], steering_rad: Mapping[int, float]) -> int:
    """Write recorded steering angles by frame number and ``has_steering`` [F]; return how many `frames` have one."""
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

    def each(
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
