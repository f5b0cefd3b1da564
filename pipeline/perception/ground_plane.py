"""Depth of a flat ground from the classes alone, for a level camera of known height: what each encoder must beat."""

import numpy as np

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
