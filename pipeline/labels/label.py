"""Compute steering labels (paper section 4.1) from the car's motion.

Signs: yaw rate and steering angle are positive to the left. Speed v and yaw rate ψ̇ of KITTI's
drives are ``vf`` and ``wu`` of its packets, parallel to the earth's surface.
"""

from typing import NamedTuple

import numpy as np

from pipeline.labels.label_file import Labels

# Forward speed in m/s below which the car rolls backwards. At standstill, KITTI's recorded speed
# dips to -0.15.
REVERSING_MPS = -0.5
# Magnitude in rad of the steering angle above which a frame turns. It is a radius of 135 m.
TURNING_RAD = 0.02


class Car(NamedTuple):
    """Parameters of the steering angle, from section labels."""

    wheelbase_m: float
    min_speed_mps: float


def steering_angle(
    yaw_rate_radps: np.ndarray, speed_mps: np.ndarray, wheelbase_m: float
) -> np.ndarray:
    """Return the front wheel angle [F] in rad of the bicycle model, atan(L ψ̇ / v).

    In reverse, v and ψ̇ both change their sign, so the formula still holds, and left stays positive.
    At standstill, it divides noise by noise, so the angle can be anything up to ±π/2. The angle is
    0 if both are exactly 0.

    >>> yaw_rate_radps = np.array([0.2, 0.0, 0.0])
    >>> speed_mps = np.array([10.0, 10.0, 0.0])
    >>> angle_rad = steering_angle(yaw_rate_radps, speed_mps, wheelbase_m=2.7)
    >>> np.rad2deg(angle_rad).round(2).tolist()
    [3.09, 0.0, 0.0]
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        angle = np.arctan(wheelbase_m * yaw_rate_radps / speed_mps)
    return np.where((speed_mps == 0) & (yaw_rate_radps == 0), 0.0, angle)


def steering_labels(yaw_rate_radps: np.ndarray, speed_mps: np.ndarray, car: Car) -> Labels:
    """Return the labels that follow from yaw rates and speeds [F].

    An unknown rate or speed is NaN. A label is valid if both are known, and the car is at least as
    fast as its minimum speed, ahead or in reverse.
    """
    is_known = np.isfinite(speed_mps) & np.isfinite(yaw_rate_radps)
    angle_rad = steering_angle(yaw_rate_radps, speed_mps, car.wheelbase_m)
    moves = is_known & (np.abs(speed_mps) >= car.min_speed_mps)
    return Labels(
        steering_rad=np.where(is_known, angle_rad, 0.0),
        valid=moves,
        speed_mps=speed_mps,
        yaw_rate_radps=yaw_rate_radps,
    )


def hold_valid(values: np.ndarray, valid: np.ndarray, initial: float = 0.0) -> np.ndarray:
    """Return `values` [F], in which a value that is not `valid` repeats the last valid one.

    Values before the first valid one become `initial`.
    """
    # The initial value is appended, so its row is -1.
    rows = np.where(valid, np.arange(len(valid)), -1)
    last_valid = np.maximum.accumulate(rows)
    return np.append(values, initial)[last_valid]


def measured_angle(
    yaw_rate_radps: np.ndarray, speed_mps: np.ndarray, valid: np.ndarray, car: Car
) -> np.ndarray:
    """Return the angle of measured motion, float64 [F] in rad.

    An unmeasured frame repeats the last measured angle. Frames before the first measured one are
    NaN.
    """
    speed_mps = np.where(valid, speed_mps, np.nan).astype(np.float64)
    labels = steering_labels(yaw_rate_radps.astype(np.float64), speed_mps, car)
    return hold_valid(labels.steering_rad, labels.valid, initial=np.nan)
