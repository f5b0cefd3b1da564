"""Recorded steering angles of a drive, ``steering.csv`` beside its images: frame, steering_rad of the front wheels."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from pipeline.base.errors import InputError
from pipeline.base.files import check_increase, check_limit, read_columns

FILE = "steering.csv"
COLUMNS = ("frame", "steering_rad")
LIMIT_RAD = 1.2  # of front wheels; angles of a steering wheel, 15 times as large, exceed it in a tight bend
_EXPECTED = "Expected a CSV file with frame (number of the image) and steering_rad (front wheels, left +)"


def read(path: Path) -> dict[int, float]:
    """Return frame number → angle of the front wheels in rad, left positive.

    Raises InputError for a missing column, frame numbers that do not increase, or an implausible angle.
    """
    frame, steering_rad = read_columns(path, COLUMNS, (), _EXPECTED).values()
    check_frames(frame, path)
    check_angles(steering_rad, path)
    return dict(zip(frame.astype(np.int64).tolist(), steering_rad.tolist(), strict=True))


def check_frames(frame: np.ndarray, path: Path) -> None:
    """Raise InputError if frame numbers [N] are not integers, or do not increase."""
    check_increase("frame", frame, 1, path)
    if (wrong := (frame != np.rint(frame)) | (frame < 0)).any():
        raise InputError(f"frame = {frame[np.argmax(wrong)]:g} (expected integers from 0)", path)


def check_angles(steering_rad: np.ndarray, path: Path) -> None:
    """Raise InputError if one of the angles [N] is not finite or exceeds LIMIT_RAD."""
    fix = "Divide angles of the steering wheel by the steering ratio"
    check_limit("steering_rad", steering_rad, LIMIT_RAD, path, fix)


def write(path: Path, steering_rad: Mapping[int, float]) -> None:
    """Write frame number → angle in rad."""
    rows = (f"{frame},{angle:.9g}\n" for frame, angle in steering_rad.items())
    path.write_text(",".join(COLUMNS) + "\n" + "".join(rows), encoding="ascii")
