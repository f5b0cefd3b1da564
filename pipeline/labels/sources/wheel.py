"""Recorded angles of the front wheels: steering.csv of a drive in KITTI's layout, or a log of the
steering wheel.
"""

import numpy as np

from pipeline.base.store import DriveReader
from pipeline.labels.by_row import measured_motion, recorded_motion
from pipeline.labels.label import Car, Labels

MEASURED = False
COLUMN = "steering_rad"


def read(
    raw: DriveReader, motion: DriveReader | None, car: Car, *, look_ahead: bool
) -> Labels | None:
    """Return a drive's labels: valid where an angle is recorded and the car moves, or at unknown
    speed.

    The speed is a recorded one or, in a drive without, measured; the yaw rate is the bicycle
    model's, so that a path ahead has no measured turn. Where motion is not measured because nothing
    moves, the car stands.
    """
    if COLUMN not in raw:
        return None
    speed_mps, _, stands = np.full((3, len(raw.frame)), np.nan)
    if motion:
        speed_mps, _, stands = measured_motion(raw, motion, look_ahead=look_ahead)
    if (rates := recorded_motion(raw)) is not None:
        speed_mps = rates[0]
    known, angle = raw["has_steering"].astype(bool), raw[COLUMN]
    moves = np.where(np.isfinite(speed_mps), np.abs(speed_mps) >= car.min_speed_mps, stands != 1)
    yaw_rate_radps = np.where(known, speed_mps * np.tan(angle) / car.wheelbase_m, np.nan)
    return Labels(angle, known & moves, speed_mps, yaw_rate_radps)
