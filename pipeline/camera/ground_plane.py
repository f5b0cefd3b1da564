"""Compute the depth of flat ground, a baseline for encoders and a cap for traffic's depth."""

import numpy as np

from pipeline.camera import classes
from pipeline.camera.camera import Camera
from pipeline.camera.geometry import rays

# Largest depth of the plane in metres, which pixels at the horizon and above it have.
MAX_DEPTH_M = 120.0
# Largest depth in metres of pixels that are taken as ground: more distant ones cover many metres.
MAX_GROUND_M = 80.0


def ground_plane_depth(cls: np.ndarray, camera: Camera) -> np.ndarray:
    """Return the depth float64 [H,W] in metres of flat ground and of objects on it.

    The camera is level. Ground has Z = f·h/(v - c_y). Other pixels, the sky included, have the
    depth of the next ground pixel below them, or of the bottom row.
    """
    height = cls.shape[0]
    slope = rays(camera.K, (height, 1))[..., 1]  # y/z of each row, [H,1]
    row_depth_m = camera.height_m * (1 / slope.clip(min=camera.height_m / MAX_DEPTH_M))
    plane_m = np.broadcast_to(row_depth_m, cls.shape)

    # The row of the next ground pixel below: a running minimum from the bottom row upwards.
    ground = np.isin(cls, classes.GROUND) & (plane_m < MAX_GROUND_M)
    rows = np.where(ground, np.arange(height)[:, None], height - 1)
    foot = np.minimum.accumulate(rows[::-1])[::-1]
    return np.take_along_axis(plane_m, foot, axis=0)
