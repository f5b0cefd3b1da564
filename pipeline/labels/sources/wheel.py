"""Recorded angles of the front wheels: steering.csv of a drive in KITTI's layout, or a log of the steering wheel."""

import numpy as np

from pipeline.base.store import DriveReader
from pipeline.labels.label import Car, Labels, steering_labels
from pipeline.labels.recorded import measured_motion, recorded_motion

MEASURED = False
COLUMN = "steering_rad"


def read(raw: DriveReader, motion: DriveReader | None, car: Car, *, look_ahead: bool) -> Labels | None:
    """Return a drive's labels: valid where an angle is recorded and the car moves, or at unknown speed.

    Speed and yaw rate are recorded ones or, in a drive without, measured. Where motion is not measured because nothing
    moves, the car stands.
    """
    if COLUMN not in raw:
        return None
    speed_mps, yaw_rate_radps, stands = np.full((3, len(raw.frame)), np.nan)
    if motion:
        speed_mps, yaw_rate_radps, stands = measured_motion(raw, motion, look_ahead=look_ahead)
    if (rates := recorded_motion(raw)) is not None:
        speed_mps, yaw_rate_radps = rates
    labels = steering_labels(yaw_rate_radps, speed_mps, car)
    valid = labels.valid | ~np.isfinite(speed_mps) & (stands != 1)
    return labels._replace(steering_rad=raw[COLUMN], valid=valid & raw["has_steering"].astype(bool))
