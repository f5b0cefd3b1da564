"""Depth of flat ground, predicted from the classes for a level camera of known height.

It is the baseline for encoders, and an upper limit for the depth of traffic.
"""

import numpy as np

from pipeline.camera import classes
from pipeline.camera.geometry import rays


def ground_plane_depth(cls: np.ndarray, K: np.ndarray, camera_height_m: float) -> np.ndarray:
    """Return depth float64 [H,W] in metres; see :func:`models.encoder.ground_depth.ground_plane_depth`.

    Args:
        cls: trainIds [H,W].
        K: intrinsics [3,3].
        camera_height_m: over the ground.
    """
    import torch

    from models.encoder import ground_depth

    slope = rays(K, (cls.shape[0], 1))[..., 1]  # [H,1], y/z per row
    depth_m = ground_depth.ground_plane_depth(
        torch.from_numpy(cls.astype(np.int64))[None],
        torch.from_numpy(slope)[None].expand(1, *cls.shape),
        camera_height_m,
    )
    return depth_m[0].numpy()


def limit_traffic_depth(
    depth: np.ndarray, cls: np.ndarray, K: np.ndarray, camera_height_m: float, reach: float
) -> None:
    """Limit the depth of traffic, in place, to `reach` times the depth of flat ground at its lower edge.

    Monocular depth takes smooth and bright surfaces, for instance the side of a tanker, for the sky.

    Two cases where the limit is wrong: downhill by more than `reach` allows, traffic gets too near; uphill there is no
    effect. A vehicle behind another one gets the depth of the nearer one.

    Args:
        depth: [H,W] in metres.
        cls, K, camera_height_m: as in :func:`ground_plane_depth`.
        reach: at least 1; the margin above 1 allows for slopes.
    """
    traffic = np.isin(cls, classes.TRAFFIC)
    if traffic.any():
        ground_m = ground_plane_depth(cls, K, camera_height_m)
        depth[traffic] = np.minimum(depth[traffic], reach * ground_m[traffic])
