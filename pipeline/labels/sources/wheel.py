"""Labels from recorded angles of the front wheels.

The angles are in steering.csv of a drive in KITTI's layout, or in a log of the steering wheel.
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
    """Return a drive's labels, or None if it has no recorded angles.

    A label is valid if the frame has a recorded angle and the car moves. The speed is the recorded
    one, or the measured one if the drive has no recorded speed. If the speed of a frame is unknown,
    the car is taken to move, unless its motion was not measured because nothing moves. The yaw rate
    is computed from the recorded angle by the bicycle model, so that the path ahead follows from
    recorded angles and not from measured turns.
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
