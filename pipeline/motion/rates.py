"""Smooth the rates of measured motion by earlier and later steps."""

import numpy as np

from pipeline.motion.motion_file import YAW_NOISE_RADPS, MeasuredRates
from pipeline.motion.speed import Speeds, smooth_speeds
from pipeline.motion.step import MEDIAN_DEVIATION

# Width (standard deviation) in seconds of the Gaussian that smooths yaw rates with a noise of
# YAW_NOISE_RADPS. It is short beside the second in which a driver turns the wheel. Noisier yaw
# rates have a wider Gaussian.
YAW_SIGMA_S = 0.1
# Largest factor on YAW_SIGMA_S. The yaw rates of Udacity's lens of 17 degrees have 3.5 times the
# noise, and a factor above 2 did not improve their angle.
MAX_WIDENING = 2.0
# Standard deviation in seconds of the Gaussian that tells whether the car goes ahead.
DIRECTION_S = 0.5
# Reach of a Gaussian on both sides, in its standard deviations.
REACH = 2.0
# Time in seconds before and after a frame in which the noise of values is estimated.
NOISE_S = 1.0
# Median of the absolute difference of two independent values of a normal distribution, in standard
# deviations.
MEDIAN_DIFFERENCE = 0.954


def smooth_rates(speeds: Speeds, yaw_rate_radps: np.ndarray) -> MeasuredRates:
    """Return the rates of M measured steps, smoothed by earlier and later steps.

    `yaw_rate_radps` [M] has the measured yaw rates of the steps of `speeds`.
    """
    noise = estimate_noise(yaw_rate_radps) / YAW_NOISE_RADPS
    sigma_s = YAW_SIGMA_S * float(np.clip(noise, 1, MAX_WIDENING))
    yaw_mean_radps, yaw_error_radps = gaussian_mean(speeds.time_s, yaw_rate_radps, sigma_s)

    # A single step that is measured backwards is an error.
    mean_mps, _ = gaussian_mean(speeds.time_s, speeds.speed_mps, DIRECTION_S)
    directed_mps = np.copysign(speeds.speed_mps, mean_mps)
    speed_mps, speed_sigma = smooth_speeds(speeds._replace(speed_mps=directed_mps))

    yaw_sigma_radps = np.maximum(YAW_NOISE_RADPS, yaw_error_radps)
    return MeasuredRates(yaw_mean_radps, speed_mps, yaw_sigma_radps, speed_sigma)


def estimate_noise(values: np.ndarray) -> float:
    """Return the standard deviation of independent noise in values [M], 0 if M < 3.

    It is that of their second differences, in which a steady change has no part.
    """
    if len(values) < 3:
        return 0.0
    second = np.diff(values.astype(np.float64), n=2)
    # Its variance is 1² + 2² + 1² = 6 times that of the values.
    return float(np.median(np.abs(second)) / MEDIAN_DEVIATION / np.sqrt(6))


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
