"""The depth of flat ground: a baseline for encoders, and the reference of a cap on the depth of
traffic.
"""

import numpy as np

from pipeline.camera import classes
from pipeline.camera.camera import Camera
from pipeline.camera.geometry import rays

MAX_DEPTH_M, MAX_GROUND_M = 120.0, 80.0  # a pixel of more distant ground covers many metres


def ground_plane_depth(cls: np.ndarray, camera: Camera) -> np.ndarray:
    """Return the depth float64 [H,W] in metres of flat ground and of objects on it, seen by a level
    camera.

    Ground has Z = f·h/(v - c_y). Other pixels, the sky included, have the depth of the next ground
    pixel below them, or of the bottom row.
    """
    height = cls.shape[0]
    slope = rays(camera.K, (height, 1))[..., 1]  # y/z per row, [H,1]
    plane = np.broadcast_to(
        camera.height_m * (1 / slope.clip(min=camera.height_m / MAX_DEPTH_M)), cls.shape
    )
    ground = np.isin(cls, classes.GROUND) & (plane < MAX_GROUND_M)
    rows = np.where(ground, np.arange(height)[:, None], height - 1)
    return np.take_along_axis(plane, np.minimum.accumulate(rows[::-1])[::-1], axis=0)
