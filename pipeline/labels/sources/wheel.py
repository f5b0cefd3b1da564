"""Labels from recorded angles of the front wheels.

They are in steering.csv of a drive in KITTI's layout, or in a log of the steering wheel.
"""

import numpy as np

from pipeline.base.store import DriveReader
from pipeline.labels.by_row import measured_motion, recorded_motion, standing
from pipeline.labels.label import Car, Labels

MEASURED = False
# Text of the message about a drive that lacks this source.
NEEDS = (
    "Recorded angles of the front wheels: steering.csv of a drive in KITTI's layout, "
    "or a log of the steering wheel"
)
COLUMN = "steering_rad"


def read(
    raw: DriveReader, motion: DriveReader | None, car: Car, *, look_ahead: bool
) -> Labels | None:
    """Return a drive's labels: valid where an angle is recorded and the car moves, if known.

    The speed is a recorded one or, in a drive without, measured; the yaw rate is the bicycle
    model's, so that a path ahead has no measured turn. Where motion is not measured because nothing
    moves, the car stands.
    """
    if COLUMN not in raw:
        return None
    speed_mps = np.full(len(raw.frame), np.nan)
    moves = np.ones(len(raw.frame), bool)
    if motion:
        speed_mps = measured_motion(raw, motion, look_ahead=look_ahead).speed_mps
        moves = ~standing(raw, motion)
    recorded = recorded_motion(raw)
    if recorded is not None:
        speed_mps = recorded.speed_mps
    moves = np.where(np.isfinite(speed_mps), np.abs(speed_mps) >= car.min_speed_mps, moves)

    has_angle = raw["has_steering"].astype(bool)
    steering_rad = raw[COLUMN]
    yaw_rate_radps = speed_mps * np.tan(steering_rad) / car.wheelbase_m
    yaw_rate_radps = np.where(has_angle, yaw_rate_radps, np.nan)
    return Labels(steering_rad, has_angle & moves, speed_mps, yaw_rate_radps)
