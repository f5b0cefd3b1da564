"""A step: the car's motion since the frame before, in the numbers that are stored, and how long it took.

``T_before`` takes points from a frame's rectified camera coordinates (x right, y down, z forward) to those of the frame
before, so its translation is where the camera has moved to, seen from where it was.
"""

from typing import NamedTuple

import numpy as np

STANDING_M = 0.02  # a step is shorter: the car stands
SIDEWAYS_M, SIDEWAYS = 0.1, 0.5  # of a step, and of its length ahead: a camera ahead of the axle swings out
FARTHEST_M = 10.0
RECENT = 20  # steps whose mean is a step's time, itself the last
SAME = 1.5  # those of them count that took at most so many times more or less than it


class Step(NamedTuple):
    """A measured step."""

    T_before: np.ndarray  # [4,4]
    inliers: int
    residual: float  # px of visual, m of lidar
    scale: float = 1.0  # what depth was multiplied by


def standing(T_before: np.ndarray) -> bool:
    """Say whether a step [4,4] is so short that it says nothing but that the car stands."""
    return bool(np.linalg.norm(T_before[:3, 3]) < STANDING_M)


def plausible(T_before: np.ndarray) -> bool:
    """Say whether a car can have moved so [4,4]: where the camera looks, not sideways, and without a jump."""
    right, down, ahead = T_before[:3, 3]
    return bool(np.hypot(right, down) < SIDEWAYS_M + SIDEWAYS * abs(ahead) and abs(ahead) < FARTHEST_M)


def rates(T_before: np.ndarray, dt_s: float) -> tuple[float, float]:
    """Return yaw rate, rad/s, left +, and forward speed, m/s, of a step [4,4] that took `dt_s`.

    Both are means over the step, so those of half a frame ago. So are KITTI's labels, as oxts' rates come 0.06 s late:
    led on to the frame's time, the angle of four real drives has an nmse of 0.0040 instead of 0.0023. Forward is where
    the camera looks half-way through it: seen from there, a camera ahead of the axle, which a turn moves sideways, goes
    as far forward as the axle does.
    """
    import cv2

    turned = cv2.Rodrigues(T_before[:3, :3])[0][:, 0]  # rotation vector; about y, which points down, left is -
    halfway = cv2.Rodrigues(turned / 2)[0]
    return float(-turned[1] / dt_s), float(halfway[:, 2] @ T_before[:3, 3] / dt_s)


def durations(frame: np.ndarray, time_s: np.ndarray) -> np.ndarray:
    """Return the time that each of `frame` [F] came after the number before, float64 [F] in seconds.

    KITTI's times are those of the packet that is nearest to an image, on a grid of 10 ms that the camera does not keep:
    between neighbours they err by a tenth. So a step's time is the mean of the last ones that took about as long; no
    later time is known to it. The first frame, which no step leads to, has that of the second.
    """
    steps = np.diff(time_s) / np.diff(frame)
    if not len(steps):
        return np.full(len(frame), np.nan)
    means = np.empty(len(steps))
    for index, own in enumerate(steps):
        recent = steps[max(0, index + 1 - RECENT) : index + 1]
        means[index] = recent[(recent < own * SAME) & (recent > own / SAME)].mean()
    return np.concatenate([means[:1], means])
