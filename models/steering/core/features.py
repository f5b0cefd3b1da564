"""Node features of points, and pooling of a frame's points."""

import torch
from torch import Tensor, nn

from pipeline.camera import classes

GEOMETRY = 6  # columns of node_features that depend on the point's position alone
NODE_FEATURES = GEOMETRY + classes.COUNT
GROUND_Y_M = 1.65  # approximate height of KITTI's ground; an offset that centres y


def node_features(xyz: Tensor, cls: Tensor, semantics: float) -> Tensor:
    """Return position features and the class one-hot, weighted by `semantics` (paper eq. 7).

    Of points [N,3] in metres in the camera frame, trainIds uint8 [N] (void has a zero one-hot) and
    λ in [0,1]; returns [N, NODE_FEATURES] in the dtype of `xyz`, each column O(1) over a street.
    """
    x, y, z = xyz.unbind(1)
    distance = torch.hypot(x, z).clamp_min(1.0)
    # The paper does not list node features. The scales fit a street seen to 80 m. x/distance is the
    # bearing: it separates near and far parts of a bend, and a network would have to learn the
    # division.
    geometry = [
        x / 10,
        (y - GROUND_Y_M) / 2,
        z / 40,
        x / distance,
        distance.log() - 2.5,
        10 / distance,
    ]
    # [trainId, COUNT]
    one_hot = semantics * torch.eye(256, classes.COUNT, dtype=xyz.dtype, device=xyz.device)
    return torch.cat(
        [torch.stack(geometry, dim=1), nn.functional.embedding(cls.int(), one_hot)], dim=1
    )


def mean_max_pool(x: Tensor, ptr: Tensor) -> Tensor:
    """Return mean ‖ max over each frame's points: [N,C], ptr [B+1] → [B,2C]; zeros for a frame
    without points.
    """
    counts = ptr.diff().tolist()
    # at once, with few launches; a CPU is faster below
    if x.device.type != "cpu" and len(x) and len(set(counts)) == 1:
        frames = x.view(len(counts), -1, x.shape[1])
        return torch.cat([frames.mean(1), frames.amax(1)], dim=1)
    # A loop over frames is faster here than segment_reduce (8x, 2 cores) and, unlike index_add,
    # deterministic on CUDA. max is faster than amax, which shares the gradient among equal values.
    parts = [
        [rows.mean(0), rows.max(0).values] if len(rows) else [rows.sum(0)] * 2
        for rows in torch.split(x, counts)
    ]
    return torch.stack([torch.cat(part) for part in parts])
