"""Node features of points, and pooling of a frame's points."""

import torch
from torch import Tensor, nn

from pipeline.camera import classes

# Number of node features that depend on a point's position alone. They are the first columns.
GEOMETRY = 6
# Number of node features, with a column for each class.
NODE_FEATURES = GEOMETRY + classes.COUNT
# Factors [NODE_FEATURES, 1] that give the node features of the mirror image: x and the bearing
# x/distance change their sign.
MIRROR_SIGNS = [[-1.0] if column in (0, 3) else [1.0] for column in range(NODE_FEATURES)]
# Approximate y of the ground in KITTI, in metres. It is subtracted to centre y.
GROUND_Y_M = 1.65


def node_features(xyz: Tensor, cls: Tensor, semantics: float) -> Tensor:
    """Return position features and the class one-hot, weighted by `semantics` (paper eq. 7).

    Args:
        xyz: points [N,3] in metres in the camera frame.
        cls: trainIds, uint8 [N]; void has a zero one-hot.
        semantics: λ in [0,1].
    Returns [N, NODE_FEATURES] in the dtype of `xyz`, each column O(1) over a street.

    >>> xyz = torch.tensor([[10.0, 1.65, 40.0]])
    >>> features = node_features(xyz, torch.tensor([classes.CAR]), semantics=0.5)
    >>> features.shape
    torch.Size([1, 25])
    >>> features[0, :3].tolist()  # x, y and z
    [1.0, 0.0, 1.0]
    >>> features[0, GEOMETRY:].tolist().index(0.5) == classes.CAR
    True
    """
    x, y, z = xyz.unbind(1)
    distance = torch.hypot(x, z).clamp_min(1.0)
    # The paper does not list its node features. The scales here suit a street up to 80 m away.
    # x/distance is the bearing, which separates near and far parts of a bend. It is given, since a
    # network would otherwise have to learn the division.
    columns = [
        x / 10,
        (y - GROUND_Y_M) / 2,
        z / 40,
        x / distance,
        distance.log() - 2.5,
        10 / distance,
    ]
    geometry = torch.stack(columns, dim=1)
    weights = semantics * torch.eye(256, classes.COUNT, dtype=xyz.dtype, device=xyz.device)
    one_hot = nn.functional.embedding(cls.int(), weights)
    return torch.cat([geometry, one_hot], dim=1)


def mean_max_pool(x: Tensor, ptr: Tensor) -> Tensor:
    """Return the mean and the maximum over each frame's points, side by side.

    The shapes are x [N,C], ptr [B+1] → [B,2C]. The result is 0 for a frame without points.
    """
    counts = ptr.diff().tolist()
    # On a GPU, frames of equal size are pooled at once, because few operations are faster there.
    if x.device.type != "cpu" and len(x) and len(set(counts)) == 1:
        frames = x.view(len(counts), -1, x.shape[1])
        return torch.cat([frames.mean(1), frames.amax(1)], dim=1)
    # On a CPU, a loop over frames is 8 times as fast as segment_reduce (2 cores). On CUDA it is
    # deterministic, unlike index_add. max is faster than amax, which shares the gradient among
    # equal values.
    pooled = []
    for rows in torch.split(x, counts):
        if len(rows):
            mean = rows.mean(0)
            maximum = rows.max(0).values
        else:
            mean = maximum = rows.sum(0)  # zeros
        pooled.append(torch.cat([mean, maximum]))
    return torch.stack(pooled)
