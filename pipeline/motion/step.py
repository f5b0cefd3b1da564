"""Compute the durations and rates of steps, and filter their speeds.

A step is the car's motion since the previous frame. ``T_before_now`` takes points from this frame's
rectified camera (x right, y down, z forward) to the previous frame's. Its translation is the
camera's new position in the previous frame.
"""

import math
from typing import NamedTuple

import cv2
import numpy as np

STANDSTILL = ("the image does not move", "the camera stands")
PROBLEMS = (
    "",
    "no previous frame",
    *STANDSTILL,
    "too few points can be tracked",
    "no common motion of the scene",
    "a motion that is not a car's",
)
"""Reasons why a step is not measured; the first means that it is."""

# Number of steps that are averaged for a duration, the current one included.
RECENT = 20
# Largest ratio of durations that are averaged. Steps of 2 and 3 frames of a faster video differ by
# 1.5 and are not.
SIMILAR = 1.45

# Typical speed in m/s: the geometric mean of the medians of KITTI's 55 drives above 1.5 m/s.
TYPICAL_MPS = 8.4
# Standard deviation of the logarithm of the speed in one of these drives.
SPREAD = 0.4
# Correlation time in seconds of the logarithm of the speed in one of these drives.
SPREAD_S = 20.0
# Standard deviation of the logarithm of depth's scale if all recent frames show a road.
ROAD_SCALE = 0.03
# Standard deviation of the logarithm of depth's scale if no recent frame shows a road. A network
# takes a lens of 17 degrees for KITTI's, whose focal length is 5.8 times shorter. With
# factors of 2.7 and 12, the angle on Udacity's drive had an RMSE of 0.0408 and 0.0396 rad.
NO_SCALE = math.log(5.8)
# Correlation time in seconds of the scale's error.
SCALE_S = 20.0
# Time in seconds over which the share of frames with a road is averaged.
SHARE_S = 20.0
# Least speed in m/s whose logarithm is taken.
LEAST_MPS = 0.3
# Relative standard deviation of a measured speed, apart from the scale.
LEAST_NOISE = 0.01


class Step(NamedTuple):
    """A measured step."""

    T_before_now: np.ndarray  # [4,4]
    inliers: int
    residual: float  # px
    scale: float = 1.0  # factor that was applied to depth


class Rates(NamedTuple):
    """The mean rates of a step."""

    yaw_rate_radps: float  # left positive
    speed_mps: float  # forward positive


def rates(T_before_now: np.ndarray, duration_s: float) -> Rates:
    """Return the rates of a step [4,4].

    As means over the step, they are half a frame old. KITTI's labels are too, since oxts' rates lag
    by 0.06 s: with rates extrapolated to the frame's time, the angle of four real drives has an
    nmse of 0.0040 instead of 0.0023. Forward is the camera's axis at half of the step: along it, a
    camera ahead of the axle, which a turn moves sideways, moves as far as the axle.
    """
    # The axis y points down, so a turn to the left is negative.
    rotation = cv2.Rodrigues(T_before_now[:3, :3])[0][:, 0]
    yaw_rate_radps = -rotation[1] / duration_s

    halfway = cv2.Rodrigues(rotation / 2)[0]
    forward = halfway[:, 2]
    speed_mps = forward @ T_before_now[:3, 3] / duration_s
    return Rates(yaw_rate_radps, speed_mps)


def durations(frame: np.ndarray, time_s: np.ndarray) -> np.ndarray:
    """Return the seconds of the step to each frame [F], per frame number; NaN for the first.

    Frame numbers [F] have noisy times [F]. KITTI's times are those of the oxts packet nearest to an
    image, on a grid of 10 ms, so a difference between neighbours has an error of a tenth. A step's
    duration is therefore the mean over recent steps of similar duration; later times are not used.
    """
    steps_s = np.diff(time_s) / np.diff(frame)
    result = np.full(len(frame), np.nan)
    for row, step_s in enumerate(steps_s):
        recent_s = steps_s[max(0, row + 1 - RECENT) : row + 1]
        similar = (recent_s < step_s * SIMILAR) & (recent_s > step_s / SIMILAR)
        result[row + 1] = recent_s[similar].mean()
    return result


def filter_speed(
    time_s: np.ndarray, speed_mps: np.ndarray, road: np.ndarray, noise: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return filtered speeds float64 [M] and their relative standard deviations [M]. It is causal.

    A Kalman filter: the logarithm of a measured speed is that of the true one, plus sigma times a
    scale error of variance 1. Both are Ornstein-Uhlenbeck processes, the speed with mean
    TYPICAL_MPS, SPREAD and SPREAD_S, the error with SCALE_S. Where a road gives the scale, sigma is
    small, and the filter follows the measurement. Without a road it stays near a typical speed: a
    depth network has no scale for a lens that differs much from its training lens.

    `speed_mps` [M] is measured at `time_s` [M], ascending, with relative standard deviations
    `noise` [M] apart from the scale; `road` bool [M]: whether a road was found.
    """
    filtered_mps = np.zeros(len(time_s))
    relative_sigma = np.zeros(len(time_s))

    # The state is the logarithm of the speed over TYPICAL_MPS, and the scale error.
    state = np.zeros(2)
    covariance = np.diag([SPREAD**2, 1.0])
    road_share = 0.0

    for row, step_s in enumerate(np.diff(time_s, prepend=time_s[:1])):
        # The more of the recent frames show a road, the better the scale is known.
        update = max(1 - math.exp(-step_s / SHARE_S), 1 / (row + 1))
        road_share += update * (road[row] - road_share)
        sigma = NO_SCALE * (ROAD_SCALE / NO_SCALE) ** road_share**2

        # Predict: both components return to their means.
        keep = np.exp([-step_s / SPREAD_S, -step_s / SCALE_S])
        state = keep * state
        covariance = np.outer(keep, keep) * covariance
        covariance += np.diag((1 - keep**2) * [SPREAD**2, 1.0])

        # Correct by the measured speed.
        measured = math.log(max(abs(speed_mps[row]), LEAST_MPS) / TYPICAL_MPS)
        observation = np.array([1.0, sigma])
        variance = observation @ covariance @ observation + noise[row] ** 2
        gain = covariance @ observation / variance
        state = state + gain * (measured - observation @ state)
        covariance = covariance - np.outer(gain, observation @ covariance)

        filtered_mps[row] = speed_mps[row] * math.exp(state[0] - measured)
        relative_sigma[row] = math.sqrt(covariance[0, 0])
    return filtered_mps, relative_sigma
