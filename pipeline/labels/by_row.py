"""Speeds and yaw rates by the row of an ingest file, for all sources of labels; NaN where
unknown.
"""

import numpy as np

from pipeline.base.store import DriveReader
from pipeline.motion.rates import measured_rates, stands


def recorded_motion(raw: DriveReader) -> np.ndarray | None:
    """Return recorded speeds in m/s and yaw rates in rad/s, left positive, [2,F]; None if the drive
    has none.

    They are unknown where KITTI interpolated a packet, which is no measurement.
    """
    return np.stack([raw["speed_mps"], raw["yaw_rate_radps"]]) if "speed_mps" in raw else None


def measured_motion(raw: DriveReader, motion: DriveReader, *, look_ahead: bool) -> np.ndarray:
    """Return the same of stage motion, and 1 where nothing moves, [3,F].

    With `look_ahead`, they are means over neighbouring frames, later ones included, which no model
    may get as inputs; else the causal rates that models get.
    """
    rates, rows = np.full((3, len(raw.frame)), np.nan), np.searchsorted(raw.frame, motion.frame)
    yaw_rate_radps, speed_mps, *_ = measured_rates(motion, look_ahead=look_ahead)
    rates[:, rows] = speed_mps, yaw_rate_radps, stands(motion)
    return rates
