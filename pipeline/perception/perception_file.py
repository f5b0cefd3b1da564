"""Describe and open the perception file of a drive, data/perception/<drive>.h5."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pipeline.base.store import MEANING, DriveReader, DriveWriter
from pipeline.camera import classes

STAGE = "perception"
# Versions of the layout that are read. The last one is written.
VERSIONS = [8]
# Dataset → its unit.
UNITS = {
    "frame": "",
    "time_s": "s",
    "depth_m": "1/256 m, 0 = none",
    "cls": "Cityscapes trainId",
}
# Dataset → its attributes beside the unit.
DESCRIBED: dict[str, dict[str, Any]] = {
    "frame": {MEANING: "KITTI's frame number"},
    "time_s": {MEANING: "time since the first frame of the drive"},
    "depth_m": {MEANING: "depth along the optical axis; the sky has none"},
    "cls": {MEANING: "classes of the pixels", **classes.ATTRIBUTES},
}


def create_perception(path: Path, *, drive: str, params: Mapping[str, Any]) -> DriveWriter:
    """Return the writer of a perception file."""
    return DriveWriter(
        path, stage=STAGE, version=VERSIONS[-1], drive=drive, params=params, described=DESCRIBED
    )


def open_perception(path: Path) -> DriveReader:
    """Open a perception file, which is a context manager. Raises InputError for other files."""
    return DriveReader(path, {STAGE: VERSIONS})
