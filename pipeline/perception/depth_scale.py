"""Scale the network's depth to metres (perception.depth_scale), and cap the depth of traffic (perception.reach).

``metric``: the network predicts metres. ``camera_height``: the camera's height over the road determines the scale.
"""

from typing import TYPE_CHECKING

import numpy as np

from pipeline.camera import classes
from pipeline.camera.camera import Camera
from pipeline.camera.geometry import back_project, rays

if TYPE_CHECKING:
    from pipeline.settings.perception import Perception

MIN_ROAD_PIXELS = 50
MAX_DEPTH_M, MAX_GROUND_M = 120.0, 80.0  # a pixel of more distant ground covers many metres


class DepthPostprocessor:
    """Scales the network's depth to metres for one drive; frames come in order."""

    def __init__(self, settings: "Perception", camera: Camera) -> None:
        self._settings, self._camera = settings, camera
        self._factor = 1.0 if settings.depth_scale == "metric" else 0.0  # 0: no depth before the first visible road

    def __call__(self, depth: np.ndarray, cls: np.ndarray) -> np.ndarray:
        """Return the depth of a frame in metres, 0 in the sky; `depth` float32 [H,W], in any unit, is overwritten."""
        if self._settings.depth_scale == "camera_height":
            self._factor = from_camera_height(depth, cls, self._camera) or self._factor
        np.multiply(depth, self._factor, out=depth)
        if self._settings.reach:
            limit_traffic_depth(depth, cls, self._camera, self._settings.reach)
        return np.where(cls == classes.SKY, np.float32(0), depth)


def from_camera_height(depth: np.ndarray, cls: np.ndarray, camera: Camera) -> float | None:
    """Return the camera's height divided by its height over the road's points; None if too little road is visible.

    The latter is the median of |P·n| over the points P, n the normal of the plane through them (Schön et al. 2021,
    MGNet). `depth` [H,W] in any unit, 0 = none; trainIds `cls` [H,W].
    """
    road = (cls == classes.ROAD) & (depth > 0)
    if road.sum() < MIN_ROAD_PIXELS:
        return None
    points = back_project(depth.astype(np.float64), camera.K)[road]
    centred = points - np.median(points, axis=0)
    # No SVD of the points, and einsum instead of @: BLAS splits long sums among threads, which changes the last bits.
    scatter = np.einsum("pi,pj->ij", centred, centred)
    normal = np.linalg.eigh(scatter).eigenvectors[:, 0]  # of the smallest eigenvalue
    height = float(np.median(np.abs(np.einsum("pi,i->p", points, normal))))
    return camera.height_m / height if height > 0 else None


def ground_plane_depth(cls: np.ndarray, camera: Camera) -> np.ndarray:
    """Return the depth float64 [H,W] in metres of flat ground and of objects on it, seen by a level camera.

    Ground has Z = f·h/(v - c_y). Other pixels, the sky included, have the depth of the next ground pixel below them, or
    of the bottom row. It is the baseline for encoders, and an upper limit for the depth of traffic.
    """
    height = cls.shape[0]
    slope = rays(camera.K, (height, 1))[..., 1]  # y/z per row, [H,1]
    plane = np.broadcast_to(camera.height_m * (1 / slope.clip(min=camera.height_m / MAX_DEPTH_M)), cls.shape)
    ground = np.isin(cls, classes.GROUND) & (plane < MAX_GROUND_M)
    rows = np.where(ground, np.arange(height)[:, None], height - 1)
    return np.take_along_axis(plane, np.minimum.accumulate(rows[::-1])[::-1], axis=0)


def limit_traffic_depth(depth: np.ndarray, cls: np.ndarray, camera: Camera, reach: float) -> None:
    """Limit the depth of traffic [H,W] in metres, in place, to `reach` times that of flat ground at its lower edge.

    Depth networks mistake smooth and bright surfaces, such as the side of a tanker, for the sky.

    The limit is wrong on slopes: steeper downhill than `reach` allows, traffic gets too little depth; uphill, the limit
    has no effect. A vehicle behind another one gets the depth of the nearer one.
    """
    traffic = np.isin(cls, classes.TRAFFIC)
    if traffic.any():
        ground_m = ground_plane_depth(cls, camera)
        depth[traffic] = np.minimum(depth[traffic], reach * ground_m[traffic])
