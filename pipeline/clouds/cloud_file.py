"""Describe and open the cloud file of a drive, data/clouds/<kind>/<drive>.h5."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pipeline.base.store import DriveReader, DriveWriter

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


def create_clouds(path: Path, *, drive: str, params: Mapping[str, Any]) -> DriveWriter:
    """Return the writer of a cloud file."""
    return DriveWriter(path, stage=STAGE, version=VERSIONS[-1], drive=drive, params=params)


def open_clouds(path: Path) -> DriveReader:
    """Open a cloud file, which is a context manager. Raises InputError for other files."""
    return DriveReader(path, {STAGE: VERSIONS})
