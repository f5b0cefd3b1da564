"""Depth of a flat ground from the classes alone, for a level camera of known height: what each encoder must beat."""

import numpy as np

from pipeline.camera import classes
from pipeline.camera.geometry import rays

GROUND = (classes.ROAD, classes.SIDEWALK, classes.TERRAIN)
MAX_GROUND_M = 80.0  # nearer to the horizon, a pixel is many metres
MAX_DEPTH_M = 120.0


def ground_plane_depth(cls: np.ndarray, K: np.ndarray, camera_height_m: float) -> np.ndarray:
    """Return depth float64 [H,W] in metres, an approximation.

    Ground (road, sidewalk, terrain) has Z = f·h/(v - c_y). Each other pixel is as far as the nearest ground below it in
    its column, or where the image ends; the sky, as the network's depth, has a number too.

    Args:
        cls: trainIds [H,W].
        K: intrinsics [3,3].
        camera_height_m: of the camera over the ground.
    """
    height = cls.shape[0]
    slope = rays(K, (height, 1))[:, 0, 1]  # y/z of each row
    plane = camera_height_m / np.maximum(slope, camera_height_m / MAX_DEPTH_M)
    ground = np.isin(cls, GROUND) & (plane < MAX_GROUND_M)[:, None]
    rows = np.where(ground, np.arange(height)[:, None], height - 1)
    nearest = np.minimum.accumulate(rows[::-1], axis=0)[::-1]
    return plane[nearest]
