"""Describe and open the ingest file of a drive, data/ingest/<drive>.h5."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pipeline.base.store import DriveReader, DriveWriter

STAGE = "ingest"
# Versions of the layout that are read. The last one is written.
VERSIONS = [8]
# Dataset → its unit. Where a frame lacks data, has_<name> is 0, and the row has a fill value.
UNITS = {
    "frame": "",
    "time_s": "s",
    "image": "RGB",
    "depth": "1/256 m, 0 = none",
    "cls": "trainId, 255 = void",
    "lidar": "m, m, m, reflectance",
    "lidar_ptr": "rows of lidar",
    "has_image": "",
    "has_depth": "",
    "has_cls": "",
    "has_lidar": "",
    "oxts": "as KITTI's oxts/dataformat.txt",
    "steering_rad": "rad, left positive",
    "has_steering": "",
    "speed_mps": "m/s, forward positive",
    "left_mps": "m/s, left positive",
    "yaw_rate_radps": "rad/s, left positive",
    "K": "pixels",
    "crop": "pixels",
    "T_cam_velo": "m",
}


def create_ingest(path: Path, *, drive: str, params: Mapping[str, Any]) -> DriveWriter:
    """Return the writer of an ingest file."""
    return DriveWriter(path, stage=STAGE, version=VERSIONS[-1], drive=drive, params=params)


def open_ingest(path: Path) -> DriveReader:
    """Open an ingest file, which is a context manager. Raises InputError for other files."""
    return DriveReader(path, {STAGE: VERSIONS})
