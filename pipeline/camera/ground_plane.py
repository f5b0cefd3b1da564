"""Compute the depth of flat ground, a baseline for encoders and a cap for traffic's depth."""

import numpy as np

from pipeline.camera import classes
from pipeline.camera.camera import Camera
from pipeline.camera.geometry import camera_rays

# Largest depth of the plane in metres. Pixels at the horizon and above it have this depth.
MAX_DEPTH_M = 120.0
# Depth in metres below which a pixel counts as ground. A more distant pixel covers many metres.
MAX_GROUND_M = 80.0


def ground_plane_depth(cls: np.ndarray, camera: Camera) -> np.ndarray:
    """Return the depth float64 [H,W] in metres of flat ground and of objects on it.

    The camera is taken as level. A pixel of the ground in row v has the depth f·h/(v - c_y). Any
    other pixel, also of the sky, has the depth of the next ground pixel below it, or of the bottom
    row if no pixel below it is ground.
    """
    height = cls.shape[0]
    slope = camera_rays(camera.K, (height, 1))[..., 1]  # y/z of each row, [H,1]
    row_depth_m = camera.height_m * (1 / slope.clip(min=camera.height_m / MAX_DEPTH_M))
    plane_m = np.broadcast_to(row_depth_m, cls.shape)

    # Find the row of the next ground pixel below each pixel, which is the minimum of all ground
    # rows from the bottom up to the pixel.
    ground = np.isin(cls, classes.GROUND) & (plane_m < MAX_GROUND_M)
    rows = np.where(ground, np.arange(height)[:, None], height - 1)
    foot = np.minimum.accumulate(rows[::-1])[::-1]
    return np.take_along_axis(plane_m, foot, axis=0)
