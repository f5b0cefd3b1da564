"""A step: the car's motion since the frame before, in the numbers that are stored, and how long it took.

``T_before`` takes points from a frame's rectified camera coordinates (x right, y down, z forward) to those of the frame
before, so its translation is where the camera has moved to, seen from where it was.
"""

from typing import NamedTuple

import numpy as np

WINDOW = 10  # steps before and after, whose mean is a step's time
SIDEWAYS_M, SIDEWAYS = 0.1, 0.5  # of a step, and of its length ahead: a camera ahead of the axle swings out
FARTHEST_M = 10.0
SAME = 1.5  # they count if they took at most so many times more or less


class Step(NamedTuple):
    """A measured step."""

    T_before: np.ndarray  # [4,4]
    inliers: int
    residual: float  # px of visual, m of lidar
    scale: float = 1.0  # what depth was multiplied by


def plausible(T_before: np.ndarray) -> bool:
    """Say whether a car can have moved so [4,4]: where the camera looks, not sideways, and without a jump."""
    right, down, ahead = T_before[:3, 3]
    return bool(np.hypot(right, down) < SIDEWAYS_M + SIDEWAYS * abs(ahead) and abs(ahead) < FARTHEST_M)


def rates(T_before: np.ndarray, dt_s: float) -> tuple[float, float]:
    """Return yaw rate, rad/s, left +, and forward speed, m/s, of a step [4,4] that took `dt_s`.

    Both are means over the step. Forward is where the camera looks half-way through it: seen from there, a camera ahead
    of the axle, which a turn moves sideways, goes as far forward as the axle does.
    """
    import cv2

    turned = cv2.Rodrigues(T_before[:3, :3])[0][:, 0]  # rotation vector; about y, which points down, left is -
    halfway = cv2.Rodrigues(turned / 2)[0]
    return float(-turned[1] / dt_s), float(halfway[:, 2] @ T_before[:3, 3] / dt_s)


def durations(frame: np.ndarray, time_s: np.ndarray) -> np.ndarray:
    """Return the time from one frame number to the next around each of `frame` [F], float64 [F] in seconds.

    KITTI's times are those of the packet that is nearest to an image, on a grid of 10 ms that the camera does not keep:
    between neighbours they err by a tenth. So a step's time is the mean of those around it that take about as long.
    """
    steps = np.diff(time_s) / np.diff(frame)
    if not len(steps):
        return np.full(len(frame), np.nan)
    means = np.empty(len(steps))
    for index, own in enumerate(steps):
        around = steps[max(0, index - WINDOW) : index + WINDOW + 1]
        means[index] = around[(around < own * SAME) & (around > own / SAME)].mean()
    return np.concatenate([means[:1], means])
