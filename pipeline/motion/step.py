"""Compute the durations and rates of steps.

A step is the car's motion since the previous frame. ``T_before_now`` takes points from this frame's
rectified camera (x right, y down, z forward) to the previous frame's. Its translation is the
camera's new position in the previous frame.
"""

from typing import NamedTuple

import cv2
import numpy as np

# Median of the absolute deviation of a normal distribution, in standard deviations.
MEDIAN_DEVIATION = 0.6745
# Number of steps that are averaged for a duration, the current one included.
RECENT = 20
# Largest ratio of durations that are averaged. Steps of 2 and 3 frames of a faster video differ by
# 1.5 and are not.
SIMILAR = 1.45


class Step(NamedTuple):
    """A measured step."""

    T_before_now: np.ndarray  # [4,4]
    # Length relative to that of the step before, and the standard deviation of its logarithm; 0 if
    # it is unknown.
    ratio: float = 0.0
    ratio_sigma: float = 0.0


class Rates(NamedTuple):
    """The mean rates of a step."""

    yaw_rate_radps: float  # left positive
    speed_mps: float  # forward positive


def compute_rates(T_before_now: np.ndarray, duration_s: float) -> Rates:
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


def average_durations(frame: np.ndarray, time_s: np.ndarray) -> np.ndarray:
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
