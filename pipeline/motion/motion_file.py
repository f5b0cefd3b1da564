"""Describe and read the motion file of a drive, data/motion/<drive>.h5."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from pipeline.base.errors import InputError
from pipeline.base.store import DriveReader, DriveWriter

STAGE = "motion"
# Versions of the layout that are read. The last one is written.
VERSIONS = [10]
# Reasons why a step is not measured because nothing moves.
STANDSTILL = ("the image does not move", "the camera stands")
# Reasons why a step is not measured; the first means that it is. Dataset problem has their numbers.
PROBLEMS = (
    "",
    "no previous frame",
    *STANDSTILL,
    "too few points can be tracked",
    "no common motion of the scene",
    "a motion that is not a car's",
)
# Text of the codes of dataset problem.
_CODES = ", ".join(f"{code} = {text}" for code, text in enumerate(PROBLEMS) if code)
# Dataset → its unit, in the order of the file.
UNITS = {
    "frame": "",
    "time_s": "s",
    "valid": "",
    "yaw_rate_radps": "rad/s, left positive",
    "speed_mps": "m/s, forward positive",
    "ratio": "speed relative to that of the step before, by triangulation, 0 = unknown",
    "ratio_sigma": "standard deviation of the logarithm of ratio",
    "T_before_now": "m",
    "road_height_m": "m below the camera in the encoder's depth, 0 = no road found",
    "problem": f"0 = measured; {_CODES}",
    "filtered_mps": "m/s, the speed by this and earlier steps, an input of models",
    "speed_sigma": "relative standard deviation of filtered_mps",
    # These depend on later steps, too. No model gets them.
    "smooth_yaw_rate_radps": "rad/s, left positive",
    "smooth_speed_mps": "m/s, forward positive",
    "smooth_yaw_sigma_radps": "rad/s, standard deviation",
    "smooth_speed_sigma": "relative standard deviation",
}
# Least standard deviation of a yaw rate in rad/s: on KITTI odometry 03, its error is 0.2 deg/s.
YAW_NOISE_RADPS = 0.003


class CausalMotion(NamedTuple):
    """The car's motion since the previous frame, left and forward positive.

    It depends on a frame and earlier ones only. Motion that is not valid is 0.
    """

    yaw_rate_radps: np.ndarray  # float32 [G]
    filtered_mps: np.ndarray  # float32 [G], speed filtered by earlier steps
    valid: np.ndarray  # uint8 [G]


class MeasuredRates(NamedTuple):
    """Rates and their standard deviations, each [F]; NaN where not measured."""

    yaw_rate_radps: np.ndarray  # left positive
    speed_mps: np.ndarray  # forward positive
    yaw_sigma_radps: np.ndarray
    speed_sigma: np.ndarray  # relative


def create_motion(path: Path, *, drive: str, params: Mapping[str, Any]) -> DriveWriter:
    """Return the writer of a motion file."""
    return DriveWriter(path, stage=STAGE, version=VERSIONS[-1], drive=drive, params=params)


def open_motion(path: Path) -> DriveReader:
    """Open a motion file, which is a context manager. Raises InputError for other files."""
    return DriveReader(path, {STAGE: VERSIONS})


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


def read_rates(motion: DriveReader, *, smooth: bool) -> MeasuredRates:
    """Return the rates of the F frames in a file of stage motion.

    With `smooth`, they are smoothed by earlier and later steps. Otherwise they are those that
    models get: yaw rates of single steps, and speeds filtered by earlier steps.
    """
    valid = motion["valid"] > 0
    if smooth:
        columns = [motion[f"smooth_{name}"] for name in MeasuredRates._fields]
    else:
        yaw_sigma_radps = np.full(len(valid), YAW_NOISE_RADPS)
        columns = [
            motion["yaw_rate_radps"],
            motion["filtered_mps"],
            yaw_sigma_radps,
            motion["speed_sigma"],
        ]
    return MeasuredRates(*[np.where(valid, column.astype(float), np.nan) for column in columns])


def is_standing(motion: DriveReader) -> np.ndarray:
    """Return bool [F]: the motion of a frame is not measured because nothing moves."""
    return np.isin(motion["problem"], [PROBLEMS.index(text) for text in STANDSTILL])
