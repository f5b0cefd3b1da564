"""The images of a drive, some at a time, with what can tell their depth's scale."""

from collections.abc import Generator
from typing import NamedTuple

import numpy as np

from pipeline.base.store import DriveReader
from pipeline.camera.geometry import scan_depth


class Batch(NamedTuple):
    """Frame numbers [B], images uint8 [B,H,W,3], intrinsics [3,3], and depth [H,W] of each LiDAR scan if asked for."""

    frames: np.ndarray
    images: np.ndarray
    K: np.ndarray
    scans_m: list[np.ndarray | None]


def read(source: DriveReader, rows: np.ndarray, size: int, *, scans: bool) -> Generator[Batch]:
    """Yield the frames in `rows` of a file of stage ingest, `size` of them at a time."""
    for start in range(0, len(rows), size):
        batch = rows[start : start + size]
        # Row by row: few frames may have an image, and those between are not to be read.
        images = np.stack([source.row("image", row) for row in batch])
        scans_m = [_scan(source, row) if scans and source.row("has_lidar", row) else None for row in batch]
        yield Batch(source.frame[batch], images, source["K"], scans_m)


def calibration(source: DriveReader) -> np.ndarray | None:
    """Return T_cam_velo [4,4] of a file of stage ingest; None without one."""
    has_one = "T_cam_velo" in source
    return source["T_cam_velo"] if has_one else None


def _scan(source: DriveReader, row: int) -> np.ndarray:
    scan = source.rows("lidar", *source.rows("lidar_ptr", row, row + 2))
    _, height, width, _ = source.shape("image")
    return scan_depth(scan, source["T_cam_velo"], source["K"], (height, width))
