"""PointNet++ with single-scale grouping (paper eq. 1 and 2; Qi et al. 2017)."""

from itertools import pairwise
from typing import Annotated

import torch
from pydantic import Field
from torch import Tensor, nn

from models.steering.core.batch import SetBatch
from models.steering.core.features import NODE_FEATURES, mean_max_pool, node_features
from models.steering.core.options import NetworkOptions, Semantics, Sizes

# Length in metres by which offsets between points are divided. Neighbourhoods on a street are balls
# with diameters of 8 to 16 m.
OFFSET_M = 10.0


def mlp(*widths: int) -> nn.Sequential:
    """Return layers of Linear, LayerNorm and ReLU; the authors' code has BatchNorm instead."""
    layers: list[nn.Module] = []
    for before, after in pairwise(widths):
        layers += [nn.Linear(before, after), nn.LayerNorm(after), nn.ReLU(inplace=True)]
    return nn.Sequential(*layers)


class SetAbstraction(nn.Module):
    """f_i = max over j in N(i) of h(x_j − x_i, f_j), paper eq. 2.

    h is an MLP that all points share.
    """

    def __init__(self, inputs: int, widths: list[int]) -> None:
        super().__init__()
        self.mlp = mlp(3 + inputs, *widths)

    def forward(self, xyz: Tensor, f: Tensor, centres: Tensor, neighbours: Tensor) -> Tensor:
        """Return the features [M, widths[-1]] of the centres.

        Args:
            xyz: points [P,3] in metres.
            f: their features [P,inputs].
            centres: int32 [M], rows of the points.
            neighbours: int32 [M,n], rows of the points around each centre.
        """
        offset = (xyz[neighbours] - xyz[centres][:, None]) / OFFSET_M  # [M,n,3]
        h: Tensor = self.mlp(torch.cat([offset, f[neighbours]], dim=2))  # [M,n,width]
        return h.amax(1)


class Options(NetworkOptions):
    kind = "pointnet2"
    width: Annotated[float, Field(gt=0, le=4)] = 1.0  # factor on the paper's numbers of channels
    semantics: Semantics

    def build(self, sizes: Sizes) -> nn.Module:
        return PointNet2(sizes.features, sizes.levels, self)


class PointNet2(nn.Module):
    """Set abstractions around the centres that the graph file has, and over the complete frame.

    `levels` is the number of set abstractions before the last, which is over the complete frame.
    With two levels and width 1 the channels are those of Qi et al.: 64-64-128 and 128-128-256, over
    the complete frame 256-512-1024, and then 512 and 256.
    """

    def __init__(self, features: int, levels: int, options: Options) -> None:
        super().__init__()
        self.semantics = options.semantics
        # Channels double from level to level: 64, 128, 256, …, times the width.
        channels = [max(1, round(options.width * 64 * 2**level)) for level in range(levels + 3)]
        self.levels = nn.ModuleList()
        inputs = NODE_FEATURES
        for level in range(levels):
            widths = [channels[level], channels[level], channels[level + 1]]
            self.levels.append(SetAbstraction(inputs, widths))
            inputs = channels[level + 1]

        # The complete frame is one set around the camera.
        widths = channels[levels:]
        self.whole = mlp(3 + inputs, *widths)
        self.head = mlp(*reversed(widths))
        self.read_out = nn.Linear(widths[0], features)

    def forward(self, batch: SetBatch) -> Tensor:
        xyz = batch.xyz.to(self.read_out.weight.dtype)
        ptr = batch.ptr
        f = node_features(xyz, batch.cls, self.semantics)  # [P, NODE_FEATURES]
        for layer, level in zip(self.levels, batch.levels, strict=True):
            f = layer(xyz, f, level.centres, level.neighbours)  # [M,width]
            xyz = xyz[level.centres]
            ptr = level.ptr
        h = self.whole(torch.cat([xyz / OFFSET_M, f], dim=1))  # [M,1024 width]
        _, maximum = mean_max_pool(h, ptr).chunk(2, dim=1)
        return self.read_out(self.head(maximum))
