"""Yaw rates and speeds of measured motion: causal, as models get them, or for labels, smoothed with
later frames.
"""

import numpy as np

from pipeline.base.store import DriveReader
from pipeline.motion.step import LEAST_MPS, LEAST_NOISE, PROBLEMS, STANDSTILL, filter_speed

# Standard deviations of the Gaussians. A driver turns the wheel in a second, and a car changes its
# speed more slowly; a speed from one pair of images has much more noise than a yaw rate.
YAW_SIGMA_S, SPEED_SIGMA_S = 0.2, 0.5
REACH = 2.0  # sigmas on both sides
YAW_NOISE_RADPS = 0.003  # least error of a yaw rate: KITTI odometry 03 has 0.2 deg/s


def measured_rates(motion: DriveReader, *, look_ahead: bool) -> np.ndarray:
    """Return the rates in a file of stage motion, [4,F], NaN where not measured.

    They are yaw rates in rad/s, left positive; forward speeds in m/s; and standard deviations of
    both, the speed's is relative. With `look_ahead`, rates are Gaussian means, and the speeds are
    filtered afterwards.
    """
    valid, rates = motion["valid"].astype(bool), np.full((4, len(motion.frame)), np.nan)
    names = ("yaw_rate_radps", "speed_mps", "filtered_mps", "speed_sigma", "road_height_m")
    yaw_radps, speed_mps, filtered_mps, speed_sigma, road_m = (
        motion[name][valid].astype(np.float64) for name in names
    )
    yaw_sigma = np.full(len(yaw_radps), YAW_NOISE_RADPS)
    if look_ahead:
        time_s = motion.time_s[valid]
        yaw_radps, yaw_error = gaussian_mean(time_s, yaw_radps, YAW_SIGMA_S)
        yaw_sigma = np.maximum(YAW_NOISE_RADPS, yaw_error)
        speed_mps, speed_error = gaussian_mean(time_s, speed_mps, SPEED_SIGMA_S)
        noise = np.maximum(LEAST_NOISE, speed_error / np.maximum(np.abs(speed_mps), LEAST_MPS))
        filtered_mps, speed_sigma = filter_speed(time_s, speed_mps, road_m > 0, noise)
    rates[:, valid] = yaw_radps, filtered_mps, yaw_sigma, speed_sigma
    return rates


def stands(motion: DriveReader) -> np.ndarray:
    """Return bool [F]: the motion of a frame is not measured because nothing moves."""
    return np.isin(motion["problem"], [PROBLEMS.index(text) for text in STANDSTILL])


def gaussian_mean(
    time_s: np.ndarray, values: np.ndarray, sigma_s: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return the Gaussian mean of `values` [M] around each time [M], and its error.

    The error is that of independent noise, whose consecutive differences have a median of 0.954
    standard deviations.
    """
    mean, error = np.zeros((2, len(time_s)))
    reach_s = REACH * max(YAW_SIGMA_S, SPEED_SIGMA_S)
    for row, at_s in enumerate(time_s):
        near = (time_s >= at_s - reach_s) & (time_s <= at_s + reach_s)
        seconds, nearby = time_s[near] - at_s, values[near]
        weights = np.exp(-((seconds / sigma_s) ** 2) / 2) * (np.abs(seconds) <= REACH * sigma_s)
        weights /= weights.sum()
        noise = float(np.median(np.abs(np.diff(nearby)))) / 0.954 if len(nearby) > 1 else 0.0
        mean[row], error[row] = weights @ nearby, noise * np.sqrt(weights @ weights)
    return mean, error
