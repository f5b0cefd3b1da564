"""Find the road in a frame, and the factor that scales its depth to the camera's height.

Depth networks are accurate on the road, which they learn from perspective, and less so beside it:
on real drive 2011_10_03_0042, trees get a third of their true distance while the error on the road
is a tenth.
"""

import math
from collections import deque

import numpy as np

from pipeline.camera.camera import Camera

# Length ahead of the camera of the patch where a road is searched, in camera heights.
PATCH_LENGTH = 8.0
# Half of the width of the patch where a road is searched, in camera heights.
PATCH_HALF_WIDTH = 1.5
# Largest deviation of heights on a road from their median, as a share of it.
FLAT = 0.25
# Least share of the patch with usable depth where a road is found.
MIN_VISIBLE = 0.7
# Least share of that depth with similar heights where a road is found.
MIN_FLAT = 0.6
# Least slope of a ray to a road's pixel, in metres down per metre ahead: beyond 20 camera heights,
# depth is too uncertain.
MIN_DOWN = 0.05
# Number of frames in the running median of heights: the camera's height is constant, only the error
# of depth varies.
HEIGHTS = 400
# Number of steps that determine the direction of travel.
STEPS = 50
# Length in metres of a step below which its direction is mostly noise.
MIN_STEP_M = 0.3
# Weight of the prior, travel along the camera's axis, as metres of travel.
PRIOR_M = 10.0
# Largest slope of the direction of travel in metres down per metre ahead: cameras are mounted
# level.
MAX_SLOPE = 0.1


class Road:
    """Tracks the road in front of one drive's camera."""

    def __init__(self, camera: Camera) -> None:
        """Where the camera's height is unknown, the factor of :meth:`find_road` is 1."""
        height, width = camera.size
        K = camera.K
        self._down = ((np.arange(height) - K[1, 2]) / K[1, 1])[:, None]
        self._right = ((np.arange(width) - K[0, 2]) / K[0, 0])[None]
        self._camera_height_m = camera.height_m if camera.height_known else None
        self._heights_m: deque[float] = deque(maxlen=HEIGHTS)
        # The last steps; those of a car that reverses are inverted.
        self._down_m: deque[float] = deque(maxlen=STEPS)
        self._ahead_m: deque[float] = deque(maxlen=STEPS)
        # Height of the camera in the last frame, over its road in uncorrected depth; 0: no road.
        self.frame_height_m = 0.0

    def find_road(
        self, depth_m: np.ndarray, usable: np.ndarray, still: np.ndarray
    ) -> tuple[np.ndarray, float]:
        """Return the road mask bool [H,W] and the factor that corrects depth [H,W].

        `usable` bool [H,W]: pixels with a well-defined depth, not `still`, which show no street.
        Frames come in order.
        """
        # Slopes of the rays and heights of the points below the plane along the direction of
        # travel.
        below = self._down - self.slope
        height_m = depth_m * below.astype(np.float32)

        in_front = (below > 1 / PATCH_LENGTH) & (np.abs(self._right) < PATCH_HALF_WIDTH * below)
        patch = in_front & ~still
        self.frame_height_m = _measure_height(height_m[usable & patch], int(patch.sum()))
        if self.frame_height_m:
            self._heights_m.append(self.frame_height_m)
        if not self._heights_m:
            return np.zeros(depth_m.shape, bool), 1.0

        median_m = float(np.median(self._heights_m))
        road = usable & (below > MIN_DOWN) & (np.abs(height_m / median_m - 1) < FLAT)
        if self._camera_height_m is None:
            return road, 1.0
        return road, self._camera_height_m / median_m

    @property
    def slope(self) -> float:
        """Metres down per metre ahead of the camera's path; steps are weighted by their length."""
        slope = sum(self._down_m) / (sum(self._ahead_m) + PRIOR_M)
        return min(max(slope, -MAX_SLOPE), MAX_SLOPE)

    def add_step(self, T_before_now: np.ndarray) -> None:
        """Update the direction of travel with a step [4,4]."""
        _, down_m, ahead_m = T_before_now[:3, 3].tolist()
        if abs(ahead_m) >= MIN_STEP_M:
            self._down_m.append(math.copysign(1, ahead_m) * down_m)
            self._ahead_m.append(abs(ahead_m))


def _measure_height(height_m: np.ndarray, patch_pixels: int) -> float:
    """Return the median of the heights [N] of a patch's usable points; 0 if they are no road.

    `patch_pixels` is the number of pixels of the patch.
    """
    if len(height_m) <= MIN_VISIBLE * patch_pixels:
        return 0.0
    median_m = float(np.median(height_m))
    flat = np.abs(height_m / median_m - 1) < FLAT
    if flat.mean() <= MIN_FLAT:
        return 0.0
    return median_m
