"""Gaussian means of measured rates over neighbouring frames, later ones included: for `steer measure` and for labels.

A model must not get them as inputs, since they look ahead in time.
"""

from typing import NamedTuple

import numpy as np

from pipeline.motion.step import LEAST_MPS, LEAST_NOISE, filter_speed

# Standard deviations of the means. A driver turns the wheel in a second, and a car changes its speed more slowly; a
# speed from one pair of images has much more noise than a yaw rate.
YAW_SIGMA_S, SPEED_SIGMA_S = 0.2, 0.5
REACH = 2.0  # sigmas on both sides
YAW_NOISE_RADPS = 0.003  # least error of a yaw rate: KITTI odometry 03 has 0.2 deg/s


class Rates(NamedTuple):
    """Yaw rates in rad/s, left positive, forward speeds in m/s, and their standard deviations, all [M].

    That of the speed is relative.
    """

    yaw_rate_radps: np.ndarray
    speed_mps: np.ndarray
    yaw_sigma_radps: np.ndarray
    speed_sigma: np.ndarray


def means(time_s: np.ndarray, yaw_rate_radps: np.ndarray, speed_mps: np.ndarray, road: np.ndarray) -> Rates:
    """Return means of raw rates [M] of the measured frames at times [M]; the means of the speed are then filtered.

    `road`: whether a road was found, bool [M].
    """
    yaw, yaw_error = _means(time_s, yaw_rate_radps, YAW_SIGMA_S)
    speed, speed_error = _means(time_s, speed_mps, SPEED_SIGMA_S)
    noise = np.maximum(LEAST_NOISE, speed_error / np.maximum(np.abs(speed), LEAST_MPS))
    filtered, sigma = filter_speed(time_s, speed, road, noise)
    return Rates(yaw, filtered, np.maximum(YAW_NOISE_RADPS, yaw_error), sigma)


def _means(time_s: np.ndarray, values: np.ndarray, sigma_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the Gaussian mean of `values` [M] around each time [M], and its error.

    The error is that of independent noise, whose consecutive differences have a median of 0.954 standard deviations.
    """
    result = np.zeros((2, len(time_s)))
    reach_s = REACH * max(YAW_SIGMA_S, SPEED_SIGMA_S)
    starts = np.searchsorted(time_s, time_s - reach_s, "left")
    stops = np.searchsorted(time_s, time_s + reach_s, "right")
    for row, (start, stop) in enumerate(zip(starts, stops, strict=True)):
        near, seconds = values[start:stop], time_s[start:stop] - time_s[row]
        weights = np.exp(-((seconds / sigma_s) ** 2) / 2) * (np.abs(seconds) <= REACH * sigma_s)
        weights /= weights.sum()
        error = float(np.median(np.abs(np.diff(near)))) / 0.954 if len(near) > 1 else 0.0
        result[:, row] = weights @ near, error * np.sqrt(weights @ weights)
    return result[0], result[1]
