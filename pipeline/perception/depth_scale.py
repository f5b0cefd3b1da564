"""The factor that brings a depth without a known unit to metres."""

import numpy as np

from pipeline.camera import classes
from pipeline.camera.geometry import back_project

MIN_ROAD_PIXELS = 50
MIN_TRUTH_PIXELS = 10


def from_camera_height(depth: np.ndarray, cls: np.ndarray, K: np.ndarray, camera_height_m: float) -> float | None:
    """Return the camera's height over the one that the road's points say; None if too little road is seen.

    The road's height is the median of |P·n| over its points P, n the normal of the plane through them (Schön et al.
    2021, MGNet). `depth` [H,W] in any unit, 0 where there is none; trainIds `cls` [H,W]; intrinsics `K` [3,3].
    """
    road = (cls == classes.ROAD) & (depth > 0)
    if road.sum() < MIN_ROAD_PIXELS:
        return None
    points = back_project(depth.astype(np.float64), K)[road]
    normal = np.linalg.svd(points - np.median(points, axis=0), full_matrices=False)[2][-1]
    height = float(np.median(np.abs(points @ normal)))
    return camera_height_m / height if height > 0 else None


def from_truth(depth: np.ndarray, truth_m: np.ndarray) -> float | None:
    """Return the ratio of the medians of truth and depth where both are known; None if there is too little.

    `depth` [H,W] in any unit, `truth_m` [H,W] in metres, both 0 where there is none.
    """
    known = (truth_m > 0) & (depth > 0)
    if known.sum() < MIN_TRUTH_PIXELS:
        return None
    return float(np.median(truth_m[known]) / np.median(depth[known]))
