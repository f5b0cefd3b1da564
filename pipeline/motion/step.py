"""Steps, the car's motion since the previous frame: their durations, rates, and the filter of their
speeds.

``T_before_now`` takes points from this frame's rectified camera (x right, y down, z forward) to the
previous frame's. Its translation is the camera's new position in the previous frame.
"""

import math
from collections.abc import Iterable
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
RECENT = 20  # steps that are averaged for a duration, the current one included
# only durations that differ by less are averaged: not steps of 2 and 3 frames of a faster video
SIMILAR = 1.45
# Speeds of KITTI's 55 drives, above 1.5 m/s: geometric mean of the drives' medians; standard
# deviation and correlation time of the logarithm in a drive.
TYPICAL_MPS, SPREAD, SPREAD_S = 8.4, 0.4, 20.0
# Standard deviations of the logarithm of depth's scale, if all recent frames show a road and if
# none does; correlation times of the scale's error and of the share of frames with a road.
# NO_SCALE: a network takes a lens of 17 degrees for KITTI's, whose focal length is 5.8 times
# shorter.
ROAD_SCALE, NO_SCALE, SCALE_S, SHARE_S = 0.03, math.log(5.8), 20.0, 20.0
LEAST_MPS = 0.3  # in logarithms
LEAST_NOISE = 0.01  # relative standard deviation of a measured speed, apart from the scale


class Step(NamedTuple):
    """A measured step."""

    T_before_now: np.ndarray  # [4,4]
    inliers: int
    residual: float  # px
    scale: float = 1.0  # factor that was applied to depth


def rates(T_before_now: np.ndarray, duration_s: float) -> tuple[float, float]:
    """Return yaw rate (rad/s, left positive) and forward speed (m/s) of a step [4,4].

    Both are means over the step, so they are half a frame old. KITTI's labels are too, since oxts'
    rates lag by 0.06 s: with rates extrapolated to the frame's time, the angle of four real drives
    has an nmse of 0.0040 instead of 0.0023. Forward is the camera's axis at half of the step: along
    it, a camera ahead of the axle, which a turn moves sideways, moves as far as the axle.
    """
    # y points down, so a left turn is negative
    rotation = cv2.Rodrigues(T_before_now[:3, :3])[0][:, 0]
    halfway = cv2.Rodrigues(rotation / 2)[0]
    return float(-rotation[1] / duration_s), float(halfway[:, 2] @ T_before_now[:3, 3] / duration_s)


def durations(frame: np.ndarray, time_s: np.ndarray) -> np.ndarray:
    """Return the seconds per frame of the step to each frame number [F] at noisy times [F]; NaN for
    the first.

    KITTI's times are those of the oxts packet nearest to an image, on a grid of 10 ms, so a
    difference between neighbours has an error of a tenth. A step's duration is therefore the mean
    over recent steps of similar duration; later times are not used.
    """
    steps_s = np.diff(time_s) / np.diff(frame)
    result = np.full(len(frame), np.nan)
    for row, step_s in enumerate(steps_s):
        recent = steps_s[max(0, row + 1 - RECENT) : row + 1]
        result[row + 1] = recent[(recent < step_s * SIMILAR) & (recent > step_s / SIMILAR)].mean()
    return result


def filter_speed(
    time_s: np.ndarray, speed_mps: np.ndarray, road: np.ndarray, noise: Iterable[float]
) -> tuple[np.ndarray, np.ndarray]:
    """Return filtered speeds float64 [M] and their relative standard deviations [M]. It is causal.

    A Kalman filter: the logarithm of a measured speed is that of the true one, plus sigma times a
    scale error of variance 1. Both are Ornstein-Uhlenbeck processes, the speed with mean
    TYPICAL_MPS, SPREAD and SPREAD_S, the error with SCALE_S. Where a road gives the scale, sigma is
    small, and the filter follows the measurement. Without a road it stays near a typical speed: a
    depth network has no scale for a lens that differs much from its training lens. `speed_mps` [M]
    is measured at `time_s` [M], ascending, with relative standard deviations `noise` [M] apart from
    the scale; `road` bool [M]: whether a road was found.
    """
    filtered, sigmas = np.zeros(len(time_s)), np.zeros(len(time_s))
    # of recent frames with a road
    state, covariance, share = np.zeros(2), np.diag([SPREAD**2, 1.0]), 0.0
    steps_s = np.diff(time_s, prepend=time_s[:1])
    for row, (step_s, speed, relative_noise) in enumerate(
        zip(steps_s, speed_mps, noise, strict=True)
    ):
        share += max(1 - math.exp(-step_s / SHARE_S), 1 / (row + 1)) * (road[row] - share)
        sigma = NO_SCALE * (ROAD_SCALE / NO_SCALE) ** share**2
        keep = np.exp([-step_s / SPREAD_S, -step_s / SCALE_S])
        state, covariance = keep * state, np.outer(keep, keep) * covariance
        covariance += np.diag((1 - keep**2) * [SPREAD**2, 1.0])
        observation, measured = (
            np.array([1.0, sigma]),
            math.log(max(abs(speed), LEAST_MPS) / TYPICAL_MPS),
        )
        gain = (
            covariance @ observation / (observation @ covariance @ observation + relative_noise**2)
        )
        state = state + gain * (measured - observation @ state)
        covariance = covariance - np.outer(gain, observation @ covariance)
        filtered[row] = speed * math.exp(state[0] - measured)
        sigmas[row] = math.sqrt(covariance[0, 0])
    return filtered, sigmas
