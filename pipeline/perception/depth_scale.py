"""How the network's depth comes to metres: one object for each value of ``perception.depth_scale``."""

from typing import NamedTuple

import numpy as np

from pipeline.camera import classes
from pipeline.camera.geometry import back_project
from pipeline.camera.images import DEPTH_UNITS_PER_M

MIN_ROAD_PIXELS = 50
MIN_TRUTH_PIXELS = 10


class Frame(NamedTuple):
    """A frame's depth [H,W] in the network's unit, 0 where there is none, and what can tell its scale.

    That is trainIds [H,W]; depth [H,W] in metres of the frame's own LiDAR scan, 0 where no point fell, or None without
    one; the intrinsics [3,3]; and the camera's height over the road.
    """

    depth: np.ndarray
    cls: np.ndarray
    scan_m: np.ndarray | None
    K: np.ndarray
    camera_height_m: float


class Scale:
    """How depth comes to metres. This one: the network gives them."""

    unit = f"1/{DEPTH_UNITS_PER_M} m"  # of stored depth
    needs_scan = False

    def factor(self, frame: Frame) -> float | None:
        """Return what brings the frame's depth to that which is stored; None if the frame does not tell."""
        return 1.0

    def rescale(self, frame: Frame, before: float) -> float:
        """Bring the frame's depth, in place, to that which is stored; return the factor.

        Without a road (or a scan) to tell it, the factor is that of the frame `before`.
        """
        factor = self.factor(frame) or before
        np.multiply(frame.depth, factor, out=frame.depth)
        return factor

    def scoring_factor(self, depth: np.ndarray, truth_m: np.ndarray) -> float:
        """Return what brings stored depth [H,W] to metres that can be compared with a truth [H,W], 0 = unknown."""
        return 1.0


class CameraHeight(Scale):
    """The camera's known height over the one that the road's points say."""

    def factor(self, frame: Frame) -> float | None:
        return from_camera_height(frame.depth, frame.cls, frame.K, frame.camera_height_m)


class LidarMedian(Scale):
    """Each frame's LiDAR scan."""

    needs_scan = True

    def factor(self, frame: Frame) -> float | None:
        return None if frame.scan_m is None else median_ratio(frame.depth, frame.scan_m)


class Unscaled(Scale):
    """Nothing: depth stays as the network gives it, and is compared with a truth after scaling by the medians."""

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
    """Return the camera's height over the one that the road's points say; None if too little road is seen.

    The road's height is the median of |P·n| over its points P, n the normal of the plane through them (Schön et al.
    2021, MGNet). `depth` [H,W] in any unit, 0 where there is none; trainIds `cls` [H,W]; intrinsics `K` [3,3].
    """
    road = (cls == classes.ROAD) & (depth > 0)
    if road.sum() < MIN_ROAD_PIXELS:
        return None
    points = back_project(depth.astype(np.float64), K)[road]
    centred = points - np.median(points, axis=0)
    # Not an SVD of the points, and einsum in place of @: BLAS splits long sums among threads, which shows in the bytes.
    scatter = np.einsum("pi,pj->ij", centred, centred)
    normal = np.linalg.eigh(scatter).eigenvectors[:, 0]  # of the smallest eigenvalue
    height = float(np.median(np.abs(np.einsum("pi,i->p", points, normal))))
    return camera_height_m / height if height > 0 else None


def median_ratio(depth: np.ndarray, truth_m: np.ndarray) -> float | None:
    """Return the ratio of the medians of truth and depth where both are known; None if there is too little.

    `depth` [H,W] in any unit, `truth_m` [H,W] in metres, both 0 where there is none.
    """
    known = (truth_m > 0) & (depth > 0)
    if known.sum() < MIN_TRUTH_PIXELS:
        return None
    return float(np.median(truth_m[known]) / np.median(depth[known]))
