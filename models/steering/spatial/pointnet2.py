"""PointNet++ with single-scale grouping (paper eq. 1 and 2; Qi et al. 2017)."""

from itertools import pairwise
from typing import Annotated

import torch
from pydantic import Field
from torch import Tensor, nn

from models.steering.core.batch import SetBatch
from models.steering.core.features import NODE_FEATURES, mean_max_pool, node_features
from models.steering.core.options import NetworkOptions, Semantics, Sizes

OFFSET_M = 10.0  # scale of a neighbour's offset: balls on a street are 8 to 16 m wide


def mlp(*widths: int) -> nn.Sequential:
    """Return layers of a linear product, LayerNorm and ReLU; the reference has BatchNorm."""
    layers: list[nn.Module] = []
    for before, after in pairwise(widths):
        layers += [nn.Linear(before, after), nn.LayerNorm(after), nn.ReLU(inplace=True)]
    return nn.Sequential(*layers)


class SetAbstraction(nn.Module):
    """f_i = max over j in N(i) of h(x_j − x_i, f_j), paper eq. 2; h is an MLP shared by all
    points.
    """

    def __init__(self, inputs: int, widths: list[int]) -> None:
        super().__init__()
        self.mlp = mlp(3 + inputs, *widths)

    def forward(self, xyz: Tensor, f: Tensor, centres: Tensor, neighbours: Tensor) -> Tensor:
        """Return the features [M, widths[-1]] of the centres.

        Points xyz [P,3] metres with features f [P,inputs]; `centres` int32 [M] and `neighbours`
        int32 [M,n] are rows.
        """
        offset = (xyz[neighbours] - xyz[centres][:, None]) / OFFSET_M  # [M,n,3]
        h: Tensor = self.mlp(torch.cat([offset, f[neighbours]], dim=2))  # [M,n,width]
        return h.amax(1)


class Options(NetworkOptions):
    kind = "pointnet2"
    width: Annotated[float, Field(gt=0, le=4)] = 1.0  # factor on the reference's channels
    semantics: Semantics

    def build(self, sizes: Sizes) -> nn.Module:
        return PointNet2(sizes.features, sizes.levels, self)


class PointNet2(nn.Module):
    """Spatial network on centres and the points around them, which the graph variant holds.

    With two levels and width 1 its sizes are the reference's: 64-64-128, 128-128-256, over the
    complete frame 256-512-1024, then 512 and 256. `levels`: set abstractions before the one over
    the complete frame.
    """

    def __init__(self, features: int, levels: int, options: Options) -> None:
        super().__init__()
        self.semantics = options.semantics
        # 64, 128, 256, …
        base = [max(1, round(options.width * 64 * 2**level)) for level in range(levels + 4)]
        sizes = [[base[level], base[level], base[level + 1]] for level in range(levels)]
        inputs = [NODE_FEATURES, *(widths[-1] for widths in sizes)]
        self.levels = nn.ModuleList(
            SetAbstraction(*pair) for pair in zip(inputs, sizes, strict=False)
        )
        # the complete frame is one set around the camera
        self.whole = mlp(3 + inputs[-1], *base[levels : levels + 3])
        self.head = mlp(*base[levels : levels + 3][::-1])
        self.read_out = nn.Linear(base[levels], features)

    def forward(self, batch: SetBatch) -> Tensor:
        dtype = self.read_out.weight.dtype
        xyz, ptr = batch.xyz.to(dtype), batch.ptr
        f = node_features(xyz, batch.cls, self.semantics)  # [P,25]
        for layer, level in zip(self.levels, batch.levels, strict=True):
            f = layer(xyz, f, level.centres, level.neighbours)  # [M,width]
            xyz, ptr = xyz[level.centres], level.ptr
        h = self.whole(torch.cat([xyz / OFFSET_M, f], dim=1))  # [M,1024 width]
        pooled = mean_max_pool(h, ptr)[:, h.shape[1] :]  # the maximum
        return self.read_out(self.head(pooled))
