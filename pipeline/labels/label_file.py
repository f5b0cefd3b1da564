"""Describe and read the label file of a drive, data/labels/<drive>.h5."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from pipeline.base.store import DriveReader, DriveWriter

STAGE = "labels"
# Versions of the layout that are read. The last one is written.
VERSIONS = [8]
# Dataset → its unit. Only files whose settings have `ahead_m` have the path ahead.
UNITS = {
    "frame": "",
    "time_s": "s",
    "steering_rad": "rad, left positive",
    "valid": "",
    "speed_mps": "m/s",
    "yaw_rate_radps": "rad/s, left positive",
    "curvature_1pm": "1/m, left positive",
    "ahead_1pm": "1/m, left positive",
    "ahead_valid": "",
}


class Labels(NamedTuple):
    """Labels of a drive's frames [F].

    An unknown speed or yaw rate is NaN, also where a recorded angle is valid.
    """

    steering_rad: np.ndarray  # float64, left positive; 0 where unknown
    valid: np.ndarray  # bool
    speed_mps: np.ndarray
    yaw_rate_radps: np.ndarray

    def select_rows(self, rows: np.ndarray | slice) -> "Labels":
        """Return the labels in some `rows`."""
        return Labels(*(values[rows] for values in self))


def create_labels(path: Path, *, drive: str, params: Mapping[str, Any]) -> DriveWriter:
    """Return the writer of a label file."""
    return DriveWriter(path, stage=STAGE, version=VERSIONS[-1], drive=drive, params=params)


def open_labels(path: Path) -> DriveReader:
    """Open a label file, which is a context manager. Raises InputError for other files."""
    return DriveReader(path, {STAGE: VERSIONS})


def read_labels(file: DriveReader) -> Labels:
    """Return the labels of an open label file."""
    columns = {name: file[name] for name in Labels._fields}
    return Labels(**columns | {"valid": file["valid"].astype(bool)})
