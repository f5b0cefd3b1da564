"""The depth of flat ground: a baseline for encoders, and a cap on the depth of traffic (perception.reach)."""

import numpy as np

from pipeline.camera import classes
from pipeline.camera.camera import Camera
from pipeline.camera.geometry import rays

MAX_DEPTH_M, MAX_GROUND_M = 120.0, 80.0  # a pixel of more distant ground covers many metres


def ground_plane_depth(cls: np.ndarray, camera: Camera) -> np.ndarray:
    """Return the depth float64 [H,W] in metres of flat ground and of objects on it, seen by a level camera.

    Ground has Z = f·h/(v - c_y). Other pixels, the sky included, have the depth of the next ground pixel below them, or
    of the bottom row.
    """
    height = cls.shape[0]
    slope = rays(camera.K, (height, 1))[..., 1]  # y/z per row, [H,1]
    plane = np.broadcast_to(camera.height_m * (1 / slope.clip(min=camera.height_m / MAX_DEPTH_M)), cls.shape)
    ground = np.isin(cls, classes.GROUND) & (plane < MAX_GROUND_M)
    rows = np.where(ground, np.arange(height)[:, None], height - 1)
    return np.take_along_axis(plane, np.minimum.accumulate(rows[::-1])[::-1], axis=0)


def limit_traffic_depth(depth: np.ndarray, cls: np.ndarray, camera: Camera, reach: float) -> None:
    """Cap the depth of traffic [H,W] in metres, in place, at `reach` times the depth of flat ground at its lower edge.

    Depth networks mistake smooth and bright surfaces, such as the side of a tanker, for the sky.
    The cap is wrong on slopes: traffic gets too little depth on descents steeper than `reach` allows, and on ascents
    the cap has no effect. A vehicle behind another one gets the depth of the nearer one.
    """
    traffic = np.isin(cls, classes.TRAFFIC)
    if traffic.any():
        ground_m = ground_plane_depth(cls, camera)
        depth[traffic] = np.minimum(depth[traffic], reach * ground_m[traffic])
