"""Scale the network's depth to metres: one object for each value of ``perception.depth_scale``."""

from typing import NamedTuple

import numpy as np

from pipeline.camera import classes
from pipeline.camera.geometry import back_project
from pipeline.camera.images import DEPTH_UNITS_PER_M

MIN_ROAD_PIXELS = 50
MIN_TRUTH_PIXELS = 10


class DepthFrame(NamedTuple):
    """Depth of a frame and the data from which its scale can be estimated."""

    depth: np.ndarray  # [H,W] in the network's unit, 0 = none
    cls: np.ndarray  # trainIds [H,W]
    scan_m: np.ndarray | None  # depth [H,W] in metres of the frame's LiDAR scan, 0 = none
    K: np.ndarray  # [3,3]
    camera_height_m: float  # over the road


class Scale:
    """Base class, and mode metric: the network predicts metres."""

    unit = f"1/{DEPTH_UNITS_PER_M} m"  # of stored depth
    needs_scan = False

    def factor(self, frame: DepthFrame) -> float | None:
        """Return the factor from the network's to stored depth; None if it cannot be estimated from this frame."""
        return 1.0

    def rescale(self, frame: DepthFrame, before: float) -> float:
        """Scale the frame's depth in place and return the factor; `before`, that of the previous frame, if unknown."""
        factor = self.factor(frame) or before
        np.multiply(frame.depth, factor, out=frame.depth)
        return factor

    def scoring_factor(self, depth: np.ndarray, truth_m: np.ndarray) -> float:
        """Return the factor from stored depth [H,W] to metres for comparison with ground truth [H,W], 0 = unknown."""
        return 1.0


class CameraHeight(Scale):
    """The camera's height over the road, divided by its height over the road's points."""

    def factor(self, frame: DepthFrame) -> float | None:
        return from_camera_height(frame.depth, frame.cls, frame.K, frame.camera_height_m)


class LidarMedian(Scale):
    """Ratio of medians to each frame's LiDAR scan."""

    needs_scan = True

    def factor(self, frame: DepthFrame) -> float | None:
        return None if frame.scan_m is None else median_ratio(frame.depth, frame.scan_m)


class Unscaled(Scale):
    """No scale: stored depth is the network's, and is compared with ground truth after scaling by the medians."""

    unit = f"1/{DEPTH_UNITS_PER_M} of an unknown unit"

    def scoring_factor(self, depth: np.ndarray, truth_m: np.ndarray) -> float:
        return median_ratio(depth, truth_m) or 1.0


MODES = {
    "metric": Scale(),
    "camera_height": CameraHeight(),
    "lidar_median": LidarMedian(),
    "none": Unscaled(),
}


def from_camera_height(depth: np.ndarray, cls: np.ndarray, K: np.ndarray, camera_height_m: float) -> float | None:
    """Return the camera's height divided by its height over the road's points; None if too little road is visible.

    The latter is the median of |P·n| over the points P, n the normal of the plane through them (Schön et al. 2021,
    MGNet). `depth` [H,W] in any unit, 0 = none; trainIds `cls` [H,W]; intrinsics `K` [3,3].
    """
    road = (cls == classes.ROAD) & (depth > 0)
    if road.sum() < MIN_ROAD_PIXELS:
        return None
    points = back_project(depth.astype(np.float64), K)[road]
    centred = points - np.median(points, axis=0)
    # No SVD of the points, and einsum instead of @: BLAS splits long sums among threads, which changes the last bits.
    scatter = np.einsum("pi,pj->ij", centred, centred)
    normal = np.linalg.eigh(scatter).eigenvectors[:, 0]  # of the smallest eigenvalue
    height = float(np.median(np.abs(np.einsum("pi,i->p", points, normal))))
    return camera_height_m / height if height > 0 else None


def median_ratio(depth: np.ndarray, truth_m: np.ndarray) -> float | None:
    """Return the ratio of the medians of truth and depth where both are known; None with too few such pixels.

    `depth` [H,W] in any unit, `truth_m` [H,W] in metres; 0 = none.
    """
    known = (truth_m > 0) & (depth > 0)
    if known.sum() < MIN_TRUTH_PIXELS:
        return None
    return float(np.median(truth_m[known]) / np.median(depth[known]))
