"""Compute steering labels (paper section 4.1) from the car's motion.

Signs: yaw rate and steering angle are positive to the left. Speed v and yaw rate ψ̇ of KITTI's
drives are ``vf`` and ``wu`` of its packets, parallel to the earth's surface.
"""

from typing import NamedTuple

import numpy as np

from pipeline.base.store import DriveReader

# Forward speed at standstill dips to -0.15 m/s in KITTI; below this limit the car rolls backwards.
REVERSING_MPS = -0.5
TURNING_RAD = 0.02  # a radius of 135 m


class Car(NamedTuple):
    """Parameters of the steering angle, from section labels."""

    wheelbase_m: float
    min_speed_mps: float


class Labels(NamedTuple):
    """Labels of a drive's frames [F]; speed and yaw rate are NaN where the source has none, in a
    file 0.
    """

    steering_rad: np.ndarray  # float64, left positive; 0 where unknown
    valid: np.ndarray  # bool
    speed_mps: np.ndarray
    yaw_rate_radps: np.ndarray

    def without(self, rows: np.ndarray) -> "Labels":
        """Return the labels with those of some `rows`, bool [F], unknown."""
        angle = np.where(rows, 0.0, self.steering_rad)
        speed_mps = np.where(rows, np.nan, self.speed_mps)
        yaw_rate_radps = np.where(rows, np.nan, self.yaw_rate_radps)
        return Labels(angle, self.valid & ~rows, speed_mps, yaw_rate_radps)

    def at(self, rows: np.ndarray | slice) -> "Labels":
        """Return the labels of some `rows`."""
        return Labels(*(values[rows] for values in self))


def read(file: DriveReader) -> Labels:
    """Return the labels in data/labels/<drive>.h5."""
    return Labels(
        file["steering_rad"], file["valid"].astype(bool), file["speed_mps"], file["yaw_rate_radps"]
    )


def steering_angle(
    yaw_rate_radps: np.ndarray, speed_mps: np.ndarray, wheelbase_m: float
) -> np.ndarray:
    """Return atan(L ψ̇ / v) [F] in rad, the front wheel angle of the bicycle model; 0 where both
    are 0.

    In reverse v and ψ̇ both change sign, so the formula holds there too: left stays positive. At
    standstill it divides noise by noise, up to ±π/2.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        angle = np.arctan(wheelbase_m * yaw_rate_radps / speed_mps)
    return np.where((speed_mps == 0) & (yaw_rate_radps == 0), 0.0, angle)


def steering_labels(yaw_rate_radps: np.ndarray, speed_mps: np.ndarray, car: Car) -> Labels:
    """Return the labels of motion [F], NaN where unknown; valid from the car's minimum speed on,
    also in reverse.
    """
    known = np.isfinite(speed_mps)
    steering_rad = np.where(known, steering_angle(yaw_rate_radps, speed_mps, car.wheelbase_m), 0.0)
    return Labels(
        steering_rad, known & (np.abs(speed_mps) >= car.min_speed_mps), speed_mps, yaw_rate_radps
    )


def held(values: np.ndarray, valid: np.ndarray, initial: float = 0.0) -> np.ndarray:
    """Return `values` [F] with each that is not `valid` replaced by the last valid one, or else by
    `initial`.
    """
    last = np.maximum.accumulate(np.where(valid, np.arange(len(valid)), -1))
    return np.append(values, initial)[last]


def measured_angle(
    yaw_rate_radps: np.ndarray, speed_mps: np.ndarray, valid: np.ndarray, car: Car
) -> np.ndarray:
    """Return the angle of measured motion, float64 [F] in rad; an unmeasured frame repeats the
    last, first ones NaN.
    """
    speed_mps = np.where(valid, speed_mps, np.nan).astype(np.float64)
    labels = steering_labels(yaw_rate_radps.astype(np.float64), speed_mps, car)
    return held(labels.steering_rad, labels.valid, initial=np.nan)
