"""Describe and open the cloud file of a drive, data/clouds/<kind>/<drive>.h5."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pipeline.base.store import MEANING, DriveReader, DriveWriter
from pipeline.camera import classes

STAGE = "clouds"
# Versions of the layout that are read. The last one is written. Clouds of version 7 differ only in
# their texts, of variable length, and lack Fletcher32.
VERSIONS = [7, 8]
# Dataset → its unit. xyz and cls are ragged: frame i has the rows ptr[i]:ptr[i + 1].
UNITS = {
    "frame": "",
    "time_s": "s",
    "xyz": "m",
    "cls": "trainId",
    "ptr": "row",
}
# Dataset → its attributes beside the unit. Columns of columns.py describe themselves.
DESCRIBED: dict[str, dict[str, Any]] = {
    "frame": {MEANING: "KITTI's frame number"},
    "time_s": {MEANING: "time since the first frame of the drive"},
    "xyz": {
        MEANING: "camera coordinates (x right, y down, z forward) in steps of 1/1024 m (paper "
        "eq. 6, 7), in Morton order within a frame"
    },
    "cls": {
        MEANING: "class; void (255) for LiDAR points that the camera does not see, and for an "
        "encoder without classes",
        **classes.ATTRIBUTES,
    },
    "ptr": {MEANING: "first point of each frame"},
}


def create_clouds(path: Path, *, drive: str, params: Mapping[str, Any]) -> DriveWriter:
    """Return the writer of a cloud file."""
    return DriveWriter(
        path, stage=STAGE, version=VERSIONS[-1], drive=drive, params=params, described=DESCRIBED
    )


def open_clouds(path: Path) -> DriveReader:
    """Open a cloud file, which is a context manager. Raises InputError for other files."""
    return DriveReader(path, {STAGE: VERSIONS})
