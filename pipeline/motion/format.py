"""Describe and read the motion file of a drive, data/motion/<drive>.h5."""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from pipeline.base.errors import InputError
from pipeline.base.store import DriveReader


class CausalMotion(NamedTuple):
    """The car's motion since the previous frame, left and forward positive.

    It depends on a frame and earlier ones only. Motion that is not valid is 0.
    """

    yaw_rate_radps: np.ndarray  # float32 [G]
    filtered_mps: np.ndarray  # float32 [G], speed filtered by earlier steps
    valid: np.ndarray  # uint8 [G]


def open_motion(path: Path) -> DriveReader:
    """Open a motion file, which is a context manager. Raises InputError if it is not one."""
    return DriveReader(path, stage="motion")


def read_causal(motion: DriveReader, drive: str, frame: np.ndarray) -> CausalMotion:
    """Return the motion of a drive's frames, given by their numbers [G].

    These are the only values of a motion file that models get. A frame that is missing in the file
    has a motion of 0 that is not valid. Raises InputError if the file is of another drive.
    """
    if motion.drive != drive:
        problem = f"expected the motion of drive {drive}, got drive {motion.drive}"
        raise InputError(problem, motion.path, "Pass the file of the same drive")
    _, rows, motion_rows = np.intersect1d(frame, motion.frame, return_indices=True)
    columns = []
    for name in CausalMotion._fields:
        measured = motion[name]
        column = np.zeros(len(frame), measured.dtype)
        column[rows] = measured[motion_rows]
        columns.append(column)
    return CausalMotion(*columns)
