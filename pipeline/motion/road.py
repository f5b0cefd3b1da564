"""Where a frame shows the road, and what depth has to be multiplied by there to agree with the camera's known height.

A depth network is trusted on the road, which it learns from perspective, and less on what stands beside it: on real
drive 2011_10_03_0042, trees get a third of their distance while the road is right to a tenth.
"""

from collections import deque

import numpy as np

AHEAD, ASIDE = 8.0, 1.5  # camera heights: the patch in front of the car where a road is looked for
FLAT = 0.25  # heights of a road differ by this share at most
MIN_SEEN = 0.7  # share of the patch that must be free: in a queue, what is seen between cars says little
MIN_FLAT = 0.6  # share of it that must be flat
MIN_DOWN = 0.05  # metres down per metre ahead, at least: farther than 20 camera heights, depth is a guess
HEIGHTS = 25  # frames whose median height counts: a camera's height does not change, what the network says of it does
STEPS, STEP_M = 50, 0.3  # so many steps tell the direction of travel; a shorter one is more noise than direction
LEVEL_M = 10.0  # so much of the way is taken for granted to have gone where the camera looks
MAX_SLOPE = 0.1  # metres down per metre ahead, at most: a camera is mounted level


class Road:
    """The road in front of one drive's camera."""

    def __init__(self, K: np.ndarray, size: tuple[int, int], camera_height_m: float | None) -> None:
        """`K` [3,3] of images of `size` (H, W); `camera_height_m` None: depth is right as it is."""
        self._down = ((np.arange(size[0]) - K[1, 2]) / K[1, 1])[:, None]
        self._right = ((np.arange(size[1]) - K[0, 2]) / K[0, 0])[None]
        self._camera_height_m = camera_height_m
        self._heights: deque[float] = deque(maxlen=HEIGHTS)
        self._ways: deque[tuple[float, float]] = deque(maxlen=STEPS)  # m down, m ahead, of a step forward

    def find(self, depth_m: np.ndarray, usable: np.ndarray) -> tuple[np.ndarray, float]:
        """Return where a frame shows road, bool [H,W], and what its depth [H,W] has to be multiplied by.

        `usable` bool [H,W]: where depth is known and no moving thing is. Frames come in order.
        """
        below = self._down - self.slope  # of a plane along the direction of travel
        height_m = depth_m * below.astype(np.float32)
        in_front = (below > 1 / AHEAD) & (np.abs(self._right) < ASIDE * below)
        patch = height_m[usable & in_front]
        if len(patch) > MIN_SEEN * in_front.sum():
            median = float(np.median(patch))
            if (np.abs(patch / median - 1) < FLAT).mean() > MIN_FLAT:
                self._heights.append(median)
        if not self._heights:
            return np.zeros(depth_m.shape, bool), 1.0
        usual_m = float(np.median(self._heights))
        road = usable & (below > MIN_DOWN) & (np.abs(height_m / usual_m - 1) < FLAT)
        return road, self._camera_height_m / usual_m if self._camera_height_m else 1.0

    @property
    def slope(self) -> float:
        """Metres down per metre ahead, of the way that the camera went; a step counts by its length."""
        down_m, ahead_m = sum(down for down, _ in self._ways), sum(ahead for _, ahead in self._ways)
        return min(max(down_m / (ahead_m + LEVEL_M), -MAX_SLOPE), MAX_SLOPE)

    def travelled(self, T_before: np.ndarray) -> None:
        """Learn the direction of travel from a step [4,4]."""
        _, down_m, ahead_m = (float(way) for way in T_before[:3, 3])
        if abs(ahead_m) >= STEP_M:
            self._ways.append((down_m, ahead_m) if ahead_m > 0 else (-down_m, -ahead_m))
