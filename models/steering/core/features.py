"""What points tell of themselves, and what is left of a frame's points when they are pooled."""

import torch
from torch import Tensor

from pipeline.camera import classes

GEOMETRY = 6  # columns of node_features that come from the point's place alone
IN_MIRROR = (-1.0, 1.0, 1.0, -1.0, 1.0, 1.0) + (1.0,) * classes.COUNT
"""What a mirror, left for right, makes of each column of node_features: those of x change sign."""
GROUND_Y_M = 1.65  # about where KITTI's ground lies; an offset only, to have y start near 0 as the others do
NODE_FEATURES = GEOMETRY + classes.COUNT


def node_features(xyz: Tensor, cls: Tensor, semantics: float) -> Tensor:
    """Describe each point by its place and, weighted by `semantics`, by its class (paper eq. 7).

    Args:
        xyz: [N,3] metres, camera frame.
        cls: uint8 [N], trainId; numbers that are no class, as void, have no class feature.
        semantics: λ in [0,1]; 0 leaves zeros where the classes were, so only geometry speaks.
    Returns:
        [N, NODE_FEATURES], each column O(1) over a street, in the dtype of `xyz`.
    """
    x, y, z = xyz.unbind(1)
    distance = (x.square() + z.square()).clamp_min(1.0).sqrt()
    # The paper names no node features. Scales fit a street seen to 80 m; x/distance is the bearing, which
    # tells near and far parts of a bend apart without the network having to learn a division.
    geometry = [x / 10, (y - GROUND_Y_M) / 2, z / 40, x / distance, distance.log() - 2.5, 10 / distance]
    one_hot = cls[:, None] == torch.arange(classes.COUNT, dtype=cls.dtype, device=cls.device)
    return torch.cat([torch.stack(geometry, dim=1), semantics * one_hot.to(xyz.dtype)], dim=1)


def mean_max_pool(x: Tensor, ptr: Tensor) -> Tensor:
    """Return each frame's mean ‖ max over its points: [N,C], ptr [B+1] → [B,2C]; zeros for a frame without points."""
    # A loop over frames is faster here than segment_reduce (8x, 2 cores) and, unlike index_add, deterministic on CUDA.
    pooled = [
        torch.cat([points.mean(0), points.amax(0)]) if len(points) else points.new_zeros(2 * x.shape[1])
        for points in torch.split(x, ptr.diff().tolist())
    ]
    return torch.stack(pooled)


def max_pool(x: Tensor, ptr: Tensor) -> Tensor:
    """Return each frame's max over its points: [N,C], ptr [B+1] → [B,C]; zeros for a frame without points."""
    return torch.stack([
        points.amax(0) if len(points) else points.new_zeros(x.shape[1])
        for points in torch.split(x, ptr.diff().tolist())
    ])  # fmt: skip
