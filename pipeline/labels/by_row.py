"""Read the recorded and the measured motion in each frame of an ingest file.

The sources of labels use these functions.
"""

from typing import NamedTuple

import numpy as np

from pipeline.base.store import DriveReader
from pipeline.motion.rates import measured_rates, stands


class Rates(NamedTuple):
    """The motion in the frames [F] of an ingest file, NaN where it is unknown."""

    speed_mps: np.ndarray  # forward positive
    yaw_rate_radps: np.ndarray  # left positive


def recorded_motion(raw: DriveReader) -> Rates | None:
    """Return the recorded motion, or None if the drive has none.

    It is unknown in frames whose packet KITTI interpolated, since that is no measurement.
    """
    if "speed_mps" not in raw:
        return None
    return Rates(raw["speed_mps"], raw["yaw_rate_radps"])


def measured_motion(raw: DriveReader, motion: DriveReader, *, look_ahead: bool) -> Rates:
    """Return the motion that stage motion measured, NaN in frames without a measurement.

    With `look_ahead`, rates are means over neighbouring frames, later ones included. No model may
    get these as inputs. Without it, they are the causal rates that models get.
    """
    yaw_rate_radps, speed_mps, *_ = measured_rates(motion, look_ahead=look_ahead)
    rows = np.searchsorted(raw.frame, motion.frame)
    rates = Rates(np.full(len(raw.frame), np.nan), np.full(len(raw.frame), np.nan))
    rates.speed_mps[rows] = speed_mps
    rates.yaw_rate_radps[rows] = yaw_rate_radps
    return rates


def standing(raw: DriveReader, motion: DriveReader) -> np.ndarray:
    """Return whether the motion of a frame is not measured because nothing moves, bool [F]."""
    mask = np.zeros(len(raw.frame), bool)
    mask[np.searchsorted(raw.frame, motion.frame)] = stands(motion)
    return mask
