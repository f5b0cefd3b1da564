"""Ground truth of depth and classes in an ingest file, from dense labels or a LiDAR scan."""

from typing import NamedTuple

import numpy as np

from pipeline.base.store import DriveReader
from pipeline.camera import classes
from pipeline.camera.camera import Camera, scan_depth
from pipeline.camera.images import to_metres


class Truth(NamedTuple):
    """Depth [H,W] in metres, 0 where unknown, and trainIds uint8 [H,W], 255 where unknown, of a
    frame.
    """

    depth_m: np.ndarray
    depth_source: str  # dense, lidar, or empty
    cls: np.ndarray


def read_truth(drive: DriveReader, camera: Camera, row: int) -> Truth:
    """Return the ground truth of a row of an ingest file. Dense depth takes precedence over
    projected LiDAR.
    """
    depth_m, source = np.zeros(camera.size, np.float32), ""
    if drive.row("has_depth", row):
        depth_m, source = to_metres(drive.row("depth", row)).astype(np.float32), "dense"
    elif drive.row("has_lidar", row):
        depth_m, source = scan_depth(drive.rows_of("lidar", row), camera), "lidar"
    cls = (
        drive.row("cls", row)
        if drive.row("has_cls", row)
        else np.full(camera.size, classes.VOID, np.uint8)
    )
    return Truth(depth_m, source, cls)
