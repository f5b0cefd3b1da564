"""Return the rates of measured motion: causal as inputs of models, or smoothed as labels."""

from typing import NamedTuple

import numpy as np

from pipeline.base.store import DriveReader
from pipeline.motion.step import LEAST_MPS, LEAST_NOISE, PROBLEMS, STANDSTILL, filter_speed

# Standard deviation in seconds of the Gaussian for yaw rates: a driver turns the wheel in a second.
YAW_SIGMA_S = 0.2
# Standard deviation in seconds of the Gaussian for speeds. A car changes its speed more slowly than
# its yaw rate, and a speed from one pair of images has much more noise.
SPEED_SIGMA_S = 0.5
# Reach of a Gaussian on both sides, in its standard deviations.
REACH = 2.0
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

    With `look_ahead`, rates are Gaussian means, and the speeds are filtered afterwards.
    """
    valid = motion["valid"].astype(bool)
    yaw_radps = motion["yaw_rate_radps"][valid]
    yaw_sigma_radps = np.full(len(yaw_radps), YAW_NOISE_RADPS)
    if not look_ahead:
        speed_mps = motion["filtered_mps"][valid]
        speed_sigma = motion["speed_sigma"][valid]
    else:
        time_s = motion.time_s[valid]
        yaw_radps, yaw_error_radps = gaussian_mean(time_s, yaw_radps, YAW_SIGMA_S)
        yaw_sigma_radps = np.maximum(YAW_NOISE_RADPS, yaw_error_radps)

        single_mps = motion["speed_mps"][valid]
        mean_mps, error_mps = gaussian_mean(time_s, single_mps, SPEED_SIGMA_S)
        relative_error = error_mps / np.maximum(np.abs(mean_mps), LEAST_MPS)
        noise = np.maximum(LEAST_NOISE, relative_error)
        road = motion["road_height_m"][valid] > 0
        speed_mps, speed_sigma = filter_speed(time_s, mean_mps, road, noise)

    columns = np.full((len(MeasuredRates._fields), len(valid)), np.nan)
    columns[:, valid] = yaw_radps, speed_mps, yaw_sigma_radps, speed_sigma
    return MeasuredRates(*columns)


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
    reach_s = REACH * max(YAW_SIGMA_S, SPEED_SIGMA_S)
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
