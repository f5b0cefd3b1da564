"""Find the road in a frame, and the factor that scales its depth to the camera's height over the
road.

Depth networks are accurate on the road, which they learn from perspective, and less so beside it:
on real drive 2011_10_03_0042, trees get a third of their true distance while the error on the road
is a tenth.
"""

from collections import deque

import numpy as np

from pipeline.camera.camera import Camera

# of the search area in front of the car, in camera heights
PATCH_LENGTH, PATCH_HALF_WIDTH = 8.0, 1.5
FLAT = 0.25  # largest relative deviation of heights on a road
MIN_VISIBLE = 0.7  # share of the patch with depth
MIN_FLAT = 0.6  # share of the patch with similar heights
# metres down per metre ahead of road pixels: beyond 20 camera heights, depth is too uncertain
MIN_DOWN = 0.05
# frames in the running median: the camera's height is constant, only the error of depth varies
HEIGHTS = 400
# number of steps that determine the direction of travel; shorter steps are mostly noise
STEPS, MIN_STEP_M = 50, 0.3
PRIOR_M = 10.0  # weight of the prior, travel along the camera's axis, as metres of travel
MAX_SLOPE = 0.1  # metres down per metre ahead: cameras are mounted level


class Road:
    """Tracks the road in front of one drive's camera."""

    def __init__(self, camera: Camera) -> None:
        """Where the camera's height is unknown, depth is not corrected: the factor of :meth:`find`
        is 1.
        """
        K, (height, width) = camera.K, camera.size
        self._down = ((np.arange(height) - K[1, 2]) / K[1, 1])[:, None]
        self._right = ((np.arange(width) - K[0, 2]) / K[0, 0])[None]
        self._camera_height_m = camera.height_m if camera.height_known else None
        self._heights: deque[float] = deque(maxlen=HEIGHTS)
        # the last frame's, of the camera over the road in uncorrected depth; 0: no road
        self.frame_height_m = 0.0
        # the last frame's pixels where a road is searched
        self.in_front = np.zeros(camera.size, bool)
        # metres down and ahead, of forward steps
        self._ways: deque[tuple[float, float]] = deque(maxlen=STEPS)

    def find(
        self, depth_m: np.ndarray, usable: np.ndarray, still: np.ndarray
    ) -> tuple[np.ndarray, float]:
        """Return the road mask bool [H,W] and the factor that corrects depth [H,W].

        `usable` bool [H,W]: pixels with a well-defined depth, not `still`, which show no street.
        Frames come in order.
        """
        below = self._down - self.slope  # of the plane along the direction of travel
        height_m = depth_m * below.astype(np.float32)
        in_front = (below > 1 / PATCH_LENGTH) & (np.abs(self._right) < PATCH_HALF_WIDTH * below)
        self.in_front = in_front & ~still
        patch, self.frame_height_m = height_m[usable & in_front], 0.0
        if len(patch) > MIN_VISIBLE * self.in_front.sum():
            median = float(np.median(patch))
            if (np.abs(patch / median - 1) < FLAT).mean() > MIN_FLAT:
                self.frame_height_m = median
                self._heights.append(median)
        if not self._heights:
            return np.zeros(depth_m.shape, bool), 1.0
        median_m = float(np.median(self._heights))
        road = usable & (below > MIN_DOWN) & (np.abs(height_m / median_m - 1) < FLAT)
        return road, self._camera_height_m / median_m if self._camera_height_m else 1.0

    @property
    def slope(self) -> float:
        """Metres down per metre ahead of the camera's path; steps are weighted by their length."""
        down_m, ahead_m = sum(down for down, _ in self._ways), sum(ahead for _, ahead in self._ways)
        return min(max(down_m / (ahead_m + PRIOR_M), -MAX_SLOPE), MAX_SLOPE)

    def add_step(self, T_before_now: np.ndarray) -> None:
        """Update the direction of travel with a step [4,4]."""
        _, down_m, ahead_m = T_before_now[:3, 3].tolist()
        if abs(ahead_m) >= MIN_STEP_M:
            self._ways.append((down_m, ahead_m) if ahead_m > 0 else (-down_m, -ahead_m))
