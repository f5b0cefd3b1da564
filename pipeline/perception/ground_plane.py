"""Depth of a flat ground from the classes alone, for a level camera of known height.

It is what each encoder must beat, and what tells where a car stands that an encoder sees too far away.
"""

import numpy as np

from pipeline.camera import classes
from pipeline.camera.geometry import rays


def ground_plane_depth(cls: np.ndarray, K: np.ndarray, camera_height_m: float) -> np.ndarray:
    """Return depth float64 [H,W] in metres, an approximation: :func:`models.encoder.ground_depth.ground_plane_depth`.

    Args:
        cls: trainIds [H,W].
        K: intrinsics [3,3].
        camera_height_m: of the camera over the ground.
    """
    import torch

    from models.encoder import ground_depth

    slope = rays(K, (cls.shape[0], 1))[..., 1]  # [H,1], y/z of each row
    depth_m = ground_depth.ground_plane_depth(
        torch.from_numpy(cls.astype(np.int64))[None],
        torch.from_numpy(slope)[None].expand(1, *cls.shape),
        camera_height_m,
    )
    return depth_m[0].numpy()


def put_on_ground(depth: np.ndarray, cls: np.ndarray, K: np.ndarray, camera_height_m: float, reach: float) -> None:
    """Bring traffic, in place, no farther than `reach` times the flat ground at its foot.

    What stands on the ground hides what lies behind its foot. Monocular depth sees through it where it is smooth and
    bright, as a tanker's flank, and takes it for the sky.

    It is wrong where the ground falls away: downhill by more than `reach` allows, the foot stands lower in the image
    than on flat ground at its distance, and traffic comes too near; uphill it does nothing. And a vehicle whose foot
    another one hides comes as near as that one.

    Args:
        depth: [H,W] in metres.
        cls, K, camera_height_m: as in :func:`ground_plane_depth`.
        reach: above 1 by as much as ground rises and falls.
    """
    traffic = np.isin(cls, classes.TRAFFIC)
    if traffic.any():
        ground_m = ground_plane_depth(cls, K, camera_height_m)
        depth[traffic] = np.minimum(depth[traffic], reach * ground_m[traffic])
