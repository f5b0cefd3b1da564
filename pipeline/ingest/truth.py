"""Ground truth of depth and classes in an ingest file, from dense labels or a LiDAR scan."""

from typing import NamedTuple

import numpy as np

from pipeline.base.store import DriveReader
from pipeline.camera import classes
from pipeline.camera.camera import Camera, scan_depth
from pipeline.camera.images import to_metres


class Truth(NamedTuple):
    """The ground truth of a frame."""

    depth_m: np.ndarray  # [H,W], 0 where unknown
    depth_source: str  # dense, lidar, or empty
    cls: np.ndarray  # trainIds uint8 [H,W], 255 where unknown


def read_truth(drive: DriveReader, camera: Camera, row: int) -> Truth:
    """Return the ground truth of a row of an ingest file.

    Dense depth takes precedence over projected LiDAR.
    """
    cls = np.full(camera.size, classes.VOID, np.uint8)
    if drive.row("has_cls", row):
        cls = drive.row("cls", row)
    if drive.row("has_depth", row):
        depth_m = to_metres(drive.row("depth", row)).astype(np.float32)
        return Truth(depth_m, "dense", cls)
    if drive.row("has_lidar", row):
        depth_m = scan_depth(drive.rows_of("lidar", row), camera)
        return Truth(depth_m, "lidar", cls)
    return Truth(np.zeros(camera.size, np.float32), "", cls)
