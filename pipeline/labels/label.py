"""Compute steering labels (paper section 4.1), their file, and the path that a steering angle leads to.

Signs: yaw rate and steering angle are positive to the left. The speed v is oxts' ``vf``, parallel to the earth's
surface, and the yaw rate ψ̇ the corresponding ``wu``.
"""

from typing import NamedTuple

import numpy as np

from pipeline.base.store import DriveWriter

# Forward speed at standstill dips to -0.15 m/s in KITTI; below this limit the car rolls backwards.
REVERSING_MPS = -0.5


class Car(NamedTuple):
    """Parameters of the steering angle, from section labels."""

    wheelbase_m: float
    min_speed_mps: float


class Labels(NamedTuple):
    """Labels of the frames [F] of a drive's ingest file; speed and yaw rate are NaN where the source has none."""

    steering_rad: np.ndarray  # float64, left positive; 0 where unknown
    valid: np.ndarray  # bool
    speed_mps: np.ndarray
    yaw_rate_radps: np.ndarray

    def at(self, rows: np.ndarray | slice) -> "Labels":
        """Return the labels of some `rows`."""
        return Labels(*(values[rows] for values in self))


def steering_angle(yaw_rate_radps: np.ndarray, speed_mps: np.ndarray, wheelbase_m: float) -> np.ndarray:
    """Return atan(L ψ̇ / v) [F] in rad, the front wheel angle of the bicycle model; 0 where both are 0.

    In reverse v and ψ̇ both change sign, so the formula holds there too: left stays positive. At standstill it divides
    noise by noise, up to ±π/2.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        angle = np.arctan(wheelbase_m * yaw_rate_radps / speed_mps)
    return np.where((speed_mps == 0) & (yaw_rate_radps == 0), 0.0, angle)


def is_usable(speed_mps: np.ndarray, valid: np.ndarray, min_speed_mps: float) -> np.ndarray:
    """Return which frames [F] have `valid` motion of at least `min_speed_mps`, in either direction."""
    return np.asarray(valid, bool) & (np.abs(speed_mps) >= min_speed_mps)


def measured_angle(yaw_rate_radps: np.ndarray, speed_mps: np.ndarray, valid: np.ndarray, car: Car) -> np.ndarray:
    """Return the :func:`steering_angle` of measured motion, float64 [F] in rad.

    Where it is not usable, it repeats the last usable angle; before the first it is 0.
    """
    usable = is_usable(speed_mps, valid, car.min_speed_mps)
    angle = steering_angle(np.asarray(yaw_rate_radps, np.float64), np.asarray(speed_mps, np.float64), car.wheelbase_m)
    last = np.maximum.accumulate(np.where(usable, np.arange(len(usable)), -1))
    return np.where(last >= 0, angle[last], 0.0)


def steering_labels(yaw_rate_radps: np.ndarray, speed_mps: np.ndarray, car: Car) -> tuple[np.ndarray, np.ndarray]:
    """Return ``steering_rad`` float64 [F], and ``valid`` bool [F]: at known speeds from the car's minimum on."""
    known = np.isfinite(speed_mps)
    steering_rad = np.where(known, steering_angle(yaw_rate_radps, speed_mps, car.wheelbase_m), 0.0)
    return steering_rad, is_usable(speed_mps, known, car.min_speed_mps)


def write(file: DriveWriter, frame: np.ndarray, time_s: np.ndarray, labels: Labels, wheelbase_m: float) -> None:
    """Write the content of data/labels/<drive>.h5: labels of the frames [F], unknown rates as 0, and tan Θ / L."""
    file.put("frame", np.asarray(frame, np.int32))
    file.put("time_s", time_s, "s")
    file.put("steering_rad", labels.steering_rad, "rad, left positive")
    file.put("valid", labels.valid.astype(np.uint8))
    file.put("speed_mps", np.nan_to_num(labels.speed_mps), "m/s")
    file.put("yaw_rate_radps", np.nan_to_num(labels.yaw_rate_radps), "rad/s, left positive")
    file.put("curvature_1pm", np.tan(labels.steering_rad) / wheelbase_m, "1/m, left positive")


def path(steering_rad: np.ndarray, speed_mps: np.ndarray, time_s: np.ndarray, wheelbase_m: float) -> np.ndarray:
    """Return the car's positions [F,2] in metres, x ahead and y to the left of its start: ψ ← ψ + v/L tan Θ dt.

    The paper's formula as printed, [x, y] ← [x, y] + v dt [cos Θ, sin Θ], takes the steering angle as the heading.
    """
    dt = np.diff(time_s)
    steering_rad, speed_mps = steering_rad[:-1], speed_mps[:-1]
    turned = speed_mps / wheelbase_m * np.tan(steering_rad) * dt
    heading = np.cumsum(turned) - turned / 2  # halfway through the step: the direction of the arc's chord
    steps = (speed_mps * dt)[:, None] * np.stack([np.cos(heading), np.sin(heading)], axis=-1)
    return np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
