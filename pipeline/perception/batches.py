"""Read the images of a drive in batches, with the LiDAR depth that some depth scales need."""

from collections.abc import Generator
from typing import NamedTuple

import numpy as np

from pipeline.base.store import DriveReader
from pipeline.camera.geometry import scan_depth


class Batch(NamedTuple):
    """B frames of a drive."""

    frame: np.ndarray  # KITTI frame numbers [B]
    images: np.ndarray  # RGB uint8 [B,H,W,3]
    K: np.ndarray  # [3,3]
    scans_m: list[np.ndarray | None]  # depth [H,W] in metres of each LiDAR scan, where requested and present


def read(source: DriveReader, rows: np.ndarray, size: int, *, scans: bool) -> Generator[Batch]:
    """Yield the frames in `rows` of a file of stage ingest in batches of `size`."""
    for start in range(0, len(rows), size):
        batch = rows[start : start + size]
        # Row by row, since frames without an image in between must not be read.
        images = np.stack([source.row("image", row) for row in batch])
        scans_m = [_scan_depth(source, row) if scans and source.row("has_lidar", row) else None for row in batch]
        yield Batch(source.frame[batch], images, source["K"], scans_m)


def _scan_depth(source: DriveReader, row: int) -> np.ndarray:
    scan = source.rows_of("lidar", row)
    _, height, width, _ = source.shape("image")
    return scan_depth(scan, source["T_cam_velo"], source["K"], (height, width))
