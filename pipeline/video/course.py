"""The course of a car from measured motion: rates, steering angle, track, and their standard deviations."""

from typing import NamedTuple

import numpy as np

from pipeline.base.store import DriveReader
from pipeline.labels.label import Car, steering_angle
from pipeline.labels.means import YAW_NOISE_RADPS, Rates, means
from pipeline.motion.step import PROBLEMS, STANDSTILL

BRIDGED_S = 1.0  # longest gap over which the track continues with the last motion
HEIGHT_SCALE = 0.2  # relative standard deviation of the speed if the camera's height over the road is unknown


class Course(NamedTuple):
    """Measured motion of F frames, left and forward positive, and poses relative to the first; NaN if not measured.

    All arrays [F]. Curvature and angle are also NaN below the minimum speed.
    """

    speed_mps: np.ndarray
    yaw_rate_radps: np.ndarray
    curvature_1pm: np.ndarray
    measured_rad: np.ndarray
    x_m: np.ndarray  # ahead
    y_m: np.ndarray  # to the left
    heading_rad: np.ndarray
    speed_sigma: np.ndarray  # relative
    measured_sigma_rad: np.ndarray


def read_course(motion: DriveReader, car: Car, *, look_ahead: bool, height_known: bool) -> Course:
    """Return the course by a file of stage motion.

    Args:
        motion: the file.
        car: for the steering angle.
        look_ahead: rates are means over neighbouring frames, later ones included; False: the causal rates.
        height_known: of the camera over the road.
    """
    valid, time_s = motion["valid"].astype(bool), motion.time_s
    names = ("yaw_rate_radps", "speed_mps", "filtered_mps", "speed_sigma", "road_height_m")
    yaw, speed, filtered, sigma, road_m = (motion[name][valid].astype(np.float64) for name in names)
    rates = Rates(yaw, filtered, np.full(len(yaw), YAW_NOISE_RADPS), sigma)
    if look_ahead:
        rates = means(time_s[valid], yaw, speed, road_m > 0)
    columns = np.full((4, len(time_s)), np.nan)
    columns[:, valid] = rates
    yaw_rate, speed_mps, yaw_sigma, speed_sigma = columns
    speed_sigma = np.hypot(speed_sigma, 0.0 if height_known else HEIGHT_SCALE)

    stands = np.isin(motion["problem"], [PROBLEMS.index(problem) for problem in STANDSTILL])
    pose = _track(time_s, valid, stands, yaw_rate, speed_mps)
    fast = np.abs(np.nan_to_num(speed_mps)) >= car.min_speed_mps
    with np.errstate(divide="ignore", invalid="ignore"):
        curvature = np.where(fast, yaw_rate / speed_mps, np.nan)
        angle = np.where(fast, steering_angle(yaw_rate, speed_mps, car.wheelbase_m), np.nan)
        curvature_sigma = np.hypot(yaw_sigma / speed_mps, curvature * speed_sigma)
    angle_sigma = car.wheelbase_m * np.cos(angle) ** 2 * curvature_sigma
    x_m, y_m, heading_rad = np.where(valid, pose, np.nan)
    return Course(speed_mps, yaw_rate, curvature, angle, x_m, y_m, heading_rad, speed_sigma, angle_sigma)


def _track(
    time_s: np.ndarray, valid: np.ndarray, stands: np.ndarray, yaw_rate: np.ndarray, speed_mps: np.ndarray
) -> np.ndarray:
    """Return x, y and heading [3,F] by integrating rates; in gaps, the last motion goes on for BRIDGED_S."""
    rows = np.arange(len(time_s))
    last, stood = (np.maximum.accumulate(np.where(mask, rows, -1)) for mask in (valid, stands))
    moves = (last >= 0) & (stood <= last) & (time_s - time_s[last] <= BRIDGED_S)
    step_s = np.diff(time_s, prepend=time_s[:1])
    turned = np.where(moves, yaw_rate[last], 0.0) * step_s
    heading = np.cumsum(turned)
    step = np.where(moves, speed_mps[last], 0.0) * step_s * np.exp(1j * (heading - turned / 2))
    place = np.cumsum(step)
    return np.stack([place.real, place.imag, heading])
