"""Filter measured speeds: separate changes of speed from errors of depth's scale."""

import math
from collections.abc import Iterable

import numpy as np

# Speeds of KITTI's 55 drives, above 1.5 m/s: geometric mean of the drives' medians; standard deviation and correlation
# time of the logarithm in a drive.
TYPICAL_MPS, SPREAD, SPREAD_S = 8.4, 0.4, 20.0
# Standard deviations of the logarithm of depth's scale where all, and where no recent frame shows a road; correlation
# times of the scale's error and of the share of frames with a road. NO_SCALE: a depth network sees a lens of 17 degrees
# as if it was KITTI's, whose focal length is 5.8 times shorter.
ROAD_SCALE, NO_SCALE, SCALE_S, SHARE_S = 0.03, math.log(5.8), 20.0, 20.0
LEAST_MPS = 0.3  # in logarithms
LEAST_NOISE = 0.01  # relative standard deviation of a measured speed, apart from the scale


def filter_speed(
    time_s: np.ndarray, speed_mps: np.ndarray, road: np.ndarray, noise: Iterable[float]
) -> tuple[np.ndarray, np.ndarray]:
    """Return filtered speeds float64 [M] and their relative standard deviations [M]. It is causal.

    A Kalman filter: the logarithm of a measured speed is that of the true one, plus sigma times a scale error of
    variance 1. Both are Ornstein-Uhlenbeck processes, the speed with mean TYPICAL_MPS, SPREAD and SPREAD_S, the error
    with SCALE_S. Where a road gives the scale, sigma is small, and the filter follows the measurement. Without a road
    it stays near a typical speed: a depth network has no scale for a lens that differs much from that of its training.

    Args:
        time_s: of the measurements [M], ascending.
        speed_mps: measured [M].
        road: whether a road was found, bool [M].
        noise: relative standard deviation of each measurement, apart from the scale.
    """
    filtered, sigmas = np.zeros(len(time_s)), np.zeros(len(time_s))
    state, covariance, share = np.zeros(2), np.diag([SPREAD**2, 1.0]), 0.0  # of recent frames with a road
    steps_s = np.diff(time_s, prepend=time_s[:1])
    for row, (step_s, speed, relative_noise) in enumerate(zip(steps_s, speed_mps, noise, strict=True)):
        share += max(1 - math.exp(-step_s / SHARE_S), 1 / (row + 1)) * (road[row] - share)
        sigma = NO_SCALE * (ROAD_SCALE / NO_SCALE) ** share**2
        keep = np.exp([-step_s / SPREAD_S, -step_s / SCALE_S])
        state, covariance = keep * state, np.outer(keep, keep) * covariance
        covariance += np.diag((1 - keep**2) * [SPREAD**2, 1.0])
        observation, measured = np.array([1.0, sigma]), math.log(max(abs(speed), LEAST_MPS) / TYPICAL_MPS)
        gain = covariance @ observation / (observation @ covariance @ observation + relative_noise**2)
        state = state + gain * (measured - observation @ state)
        covariance = covariance - np.outer(gain, observation @ covariance)
        filtered[row] = speed * math.exp(state[0] - measured)
        sigmas[row] = math.sqrt(covariance[0, 0])
    return filtered, sigmas
