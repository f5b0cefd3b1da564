"""Ground truth of a frame: depth and classes, from dense labels or a LiDAR scan."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from pipeline.base.store import DriveReader
from pipeline.camera import classes
from pipeline.camera.camera import Camera, scan_depth
from pipeline.camera.images import to_metres

OCCLUDER_RAD = 0.004
OCCLUDED_RATIO = 1.25  # neighbouring rings on flat ground differ by a quarter in distance only beyond 60 m
DepthSource = Literal["dense", "lidar"]


@dataclass(frozen=True)
class Truth:
    """Depth [H,W] in metres, 0 where unknown, and trainIds uint8 [H,W], 255 where unknown, of a frame."""

    depth_m: np.ndarray
    depth_source: DepthSource | None
    cls: np.ndarray
    has_cls: bool


def read_truth(drive: DriveReader, camera: Camera, row: int) -> Truth:
    """Return the ground truth of the frame in `row` of a file of stage ingest.

    Dense depth takes precedence over projected LiDAR, which is used without points that are hidden from the camera.
    """
    depth_m = np.zeros(camera.size, np.float32)
    source: DepthSource | None = None
    if drive.row("has_depth", row):
        depth_m, source = to_metres(drive.row("depth", row)).astype(np.float32), "dense"
    elif drive.row("has_lidar", row):
        depth_m, source = visible(scan_depth(drive.rows_of("lidar", row), camera), camera), "lidar"
    has_cls = bool(drive.row("has_cls", row))
    cls = drive.row("cls", row) if has_cls else np.full(camera.size, classes.VOID, np.uint8)
    return Truth(depth_m, source, cls, has_cls)


def visible(depth_m: np.ndarray, camera: Camera) -> np.ndarray:
    """Return sparse depth [H,W] without points that are hidden from the camera.

    The scanner is above the camera and looks over objects, so points behind an object project between those of the
    object. A point is dropped if another one within 0.23 degrees, about one ring of KITTI's scanner, is a fifth nearer.
    """
    import cv2

    reach = [max(1, round(OCCLUDER_RAD * f)) for f in (camera.K[0, 0], camera.K[1, 1])]
    known = np.where(depth_m > 0, depth_m, np.inf).astype(np.float32)
    nearest = cv2.erode(known, np.ones((2 * reach[1] + 1, 2 * reach[0] + 1), np.uint8))  # erosion is a local minimum
    return np.where(known / OCCLUDED_RATIO <= nearest, depth_m, 0).astype(depth_m.dtype)
