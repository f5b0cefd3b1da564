"""Return the rates of measured motion: causal as inputs of models, or smoothed as labels."""

from typing import NamedTuple

import numpy as np

from pipeline.base.store import DriveReader
from pipeline.motion.speed import Speeds, smooth_speeds
from pipeline.motion.step import MEDIAN_DEVIATION, PROBLEMS, STANDSTILL

# Standard deviation in seconds of the Gaussian for yaw rates with a noise of YAW_NOISE_RADPS: a
# driver turns the wheel in a second. Noisier ones need a longer one.
YAW_SIGMA_S = 0.1
# Largest factor of YAW_SIGMA_S. The yaw rates of Udacity's lens of 17 degrees have 3.5 times the
# noise; with 2, its angle is as good as with 2.5.
MORE_NOISE = 2.0
# Standard deviation in seconds of the Gaussian that tells whether the car goes ahead.
DIRECTION_S = 0.5
# Reach of a Gaussian on both sides, in its standard deviations.
REACH = 2.0
# Time in seconds before and after a frame in which the noise of values is estimated.
NOISE_S = 1.0
# Least standard deviation of a yaw rate in rad/s: on KITTI odometry 03, its error is 0.2 deg/s.
YAW_NOISE_RADPS = 0.003
# Median of the absolute difference of two independent values of a normal distribution, in standard
# deviations.
MEDIAN_DIFFERENCE = 0.954


class MeasuredRates(NamedTuple):
    """Rates of F frames and their standard deviations, each [F]; NaN where not measured."""

    yaw_rate_radps: np.ndarray  # left positive
    speed_mps: np.ndarray  # forward positive
    yaw_sigma_radps: np.ndarray
    speed_sigma: np.ndarray  # relative


def measured_rates(motion: DriveReader, *, look_ahead: bool) -> MeasuredRates:
    """Return the rates in a file of stage motion.

    With `look_ahead`, yaw rates are Gaussian means, and speeds are smoothed.
    """
    valid = motion["valid"].astype(bool)
    yaw_radps = motion["yaw_rate_radps"][valid]
    yaw_sigma_radps = np.full(len(yaw_radps), YAW_NOISE_RADPS)
    if not look_ahead:
        speed_mps = motion["filtered_mps"][valid]
        speed_sigma = motion["speed_sigma"][valid]
    else:
        time_s = motion.time_s[valid]
        sigma_s = YAW_SIGMA_S * np.clip(noise_of(yaw_radps) / YAW_NOISE_RADPS, 1, MORE_NOISE)
        yaw_radps, yaw_error_radps = gaussian_mean(time_s, yaw_radps, float(sigma_s))
        yaw_sigma_radps = np.maximum(YAW_NOISE_RADPS, yaw_error_radps)

        # A single step that is measured backwards is an error.
        single_mps = motion["speed_mps"][valid]
        mean_mps, _ = gaussian_mean(time_s, single_mps, DIRECTION_S)
        single_mps = np.copysign(single_mps, mean_mps)
        road = motion["road_height_m"][valid] > 0
        ratio = motion["ratio"][valid]
        ratio_sigma = motion["ratio_sigma"][valid]
        speeds = Speeds(time_s, single_mps, road, ratio, ratio_sigma)
        speed_mps, speed_sigma = smooth_speeds(speeds)

    columns = np.full((len(MeasuredRates._fields), len(valid)), np.nan)
    columns[:, valid] = yaw_radps, speed_mps, yaw_sigma_radps, speed_sigma
    return MeasuredRates(*columns)


def noise_of(values: np.ndarray) -> float:
    """Return the standard deviation of independent noise in values [M]; 0 of fewer than 3.

    It is that of their second differences, in which a steady change has no part.
    """
    if len(values) < 3:
        return 0.0
    second = np.diff(values.astype(np.float64), n=2)
    return float(np.median(np.abs(second)) / MEDIAN_DEVIATION / np.sqrt(6))


def stands(motion: DriveReader) -> np.ndarray:
    """Return bool [F]: the motion of a frame is not measured because nothing moves."""
    return np.isin(motion["problem"], [PROBLEMS.index(text) for text in STANDSTILL])


def gaussian_mean(
    time_s: np.ndarray, values: np.ndarray, sigma_s: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return the Gaussian mean of `values` [M] around each time [M], and its error.

    The error is that of independent noise, estimated from differences of consecutive values.
    """
    mean = np.zeros(len(time_s))
    error = np.zeros(len(time_s))
    reach_s = max(REACH * sigma_s, NOISE_S)
    for row, at_s in enumerate(time_s):
        near = (time_s >= at_s - reach_s) & (time_s <= at_s + reach_s)
        after_s = time_s[near] - at_s
        nearby = values[near].astype(np.float64)

        weights = np.exp(-((after_s / sigma_s) ** 2) / 2) * (np.abs(after_s) <= REACH * sigma_s)
        weights /= weights.sum()
        mean[row] = weights @ nearby

        if len(nearby) > 1:
            noise = float(np.median(np.abs(np.diff(nearby)))) / MEDIAN_DIFFERENCE
            error[row] = noise * np.sqrt(weights @ weights)
    return mean, error
