"""PointNet++ with single-scale grouping (paper eq. 1 and 2; Qi et al. 2017)."""

import math
from itertools import pairwise
from typing import Annotated, Self

import torch
from pydantic import Field, model_validator
from torch import Tensor, nn

from models.steering.core.batch import GraphBatch
from models.steering.core.features import NODE_FEATURES, node_features
from models.steering.core.options import Count, NetworkOptions, Semantics, Sizes

# Length in metres by which offsets between points are divided. Neighbourhoods on a street are balls
# with diameters of 8 to 16 m.
OFFSET_M = 10.0
# Odd factor of the hash of a position: 2^64 divided by the golden ratio, as a signed integer.
HASH_FACTOR = 0x9E3779B97F4A7C15 - 2**64

# A value for each level.
Counts = Annotated[tuple[Count, ...], Field(min_length=1, max_length=8, strict=False)]
Radius = Annotated[float, Field(gt=0)]
Radii = Annotated[tuple[Radius, ...], Field(min_length=1, max_length=8, strict=False)]


def build_mlp(*widths: int) -> nn.Sequential:
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
        self.mlp = build_mlp(3 + inputs, *widths)

    def forward(self, xyz: Tensor, f: Tensor, centres: Tensor, neighbours: Tensor) -> Tensor:
        """Return the features [M, widths[-1]] of the centres.

        Args:
            xyz: points [P,3] in metres.
            f: their features [P,inputs].
            centres: int64 [M], rows of the points.
            neighbours: int64 [M,n], rows of the points around each centre.
        """
        offset = (xyz[neighbours] - xyz[centres][:, None]) / OFFSET_M  # [M,n,3]
        h: Tensor = self.mlp(torch.cat([offset, f[neighbours]], dim=2))  # [M,n,width]
        return h.amax(1)


class Options(NetworkOptions):
    kind = "graph"
    width: float = Field(
        default=0.25, gt=0, le=4, description="factor on the published numbers of channels"
    )
    centres: Counts = Field(
        default=(128, 32),
        description="centres of a frame, for each level. The published network has [512, 128]",
    )
    # The published radii, 0.2 and 0.4, are for objects in a unit sphere, but a street extends about
    # 40 m.
    radius_m: Radii = Field(
        default=(3.0, 6.0),
        description="radius in metres of the ball around a centre, for each level",
    )
    neighbours: Counts = Field(
        default=(16, 16),
        description="points of a ball, for each level. The published network has [32, 64]",
    )
    semantics: Semantics

    @model_validator(mode="after")
    def _check_levels(self) -> Self:
        if len({len(self.centres), len(self.radius_m), len(self.neighbours)}) > 1:
            raise ValueError("centres, radius_m and neighbours need one number per level each")
        return self

    def build(self, sizes: Sizes) -> nn.Module:
        return PointNet2(sizes.features, self)

    def prepare(self, batch: GraphBatch) -> Tensor:
        """Return the groups of all levels of each frame, int32 [B, sum(centres (1 + neighbours))].

        The groups of a level are those of :func:`group_points`, among the centres of the level
        before. A frame without points has zeros, which :class:`PointNet2` does not read.
        """
        xyz = batch.xyz
        counts = batch.ptr.diff().to(xyz.device)
        occupied = counts.nonzero().squeeze(1)
        numbers = sum(m * (1 + n) for m, n in zip(self.centres, self.neighbours, strict=True))
        groups = torch.zeros(len(counts), numbers, dtype=torch.int32, device=xyz.device)
        if not len(occupied):
            return groups

        parts = torch.split(xyz.float(), batch.ptr.diff().tolist())
        frames = [frame for frame in parts if len(frame)]
        points = nn.utils.rnn.pad_sequence(frames, batch_first=True)  # [B,P,3]
        counts = counts[occupied]
        levels = []
        for sizes in zip(self.centres, self.radius_m, self.neighbours, strict=True):
            level = group_points(points, counts, *sizes)
            levels.append(level.flatten(1))
            points = points.gather(1, level[:, :, :1].expand(-1, -1, 3))
            counts = counts.clamp_max(points.shape[1])
        groups[occupied] = torch.cat(levels, dim=1).int()
        return groups


@torch.no_grad()
def group_points(
    points: Tensor, counts: Tensor, centres: int, radius_m: float, neighbours: int
) -> Tensor:
    """Choose centres in each frame by farthest point sampling, and group the points around each.

    The first centre is the point nearest to the camera. Each further one is the farthest from all
    centres before it. A centre's group has the first points of the ball around it in the order of
    their hashes, which also decides between points that are equally far. So groups depend neither
    on the order of the points nor on other frames, and a mirror image has the same groups. Only of
    points with the same |x|, y and z, the first in the frame comes first.

    A frame with fewer points than centres repeats its first point in this order, and so does a
    ball with fewer points. This does not change a maximum.

    Args:
        points: [B,P,3] in metres, where frame b has points in the first counts[b] ≥ 1 rows.
        counts: int64 [B].
    Returns rows of the points, int64 [B, centres, 1 + neighbours]: a centre, then its ball.
    """
    # Sort the points of a frame by their hashes. Rows without a point come last, infinitely far.
    frames, rows, _ = points.shape
    is_empty = torch.arange(rows, device=points.device) >= counts[:, None]
    last = torch.iinfo(torch.int64).max
    order = position_hash(points).masked_fill(is_empty, last).argsort(dim=1, stable=True)
    ordered = points.gather(1, order[:, :, None].expand(-1, -1, 3))
    axes = ordered.masked_fill(is_empty[:, :, None], math.inf).permute(2, 0, 1).contiguous()

    # Squared distances to the nearest centre. Rows without a point are never the farthest.
    nearest_m2 = torch.full_like(axes[0], math.inf).masked_fill(is_empty, -math.inf)
    is_member = torch.empty(centres, frames, rows, dtype=torch.bool, device=points.device)
    chosen = torch.empty(centres, frames, dtype=torch.int64, device=points.device)
    centre = squared_length(axes).argmin(1)
    for number in range(centres):
        chosen[number] = centre
        position = axes.gather(2, centre.expand(3, -1)[:, :, None])
        distance_m2 = squared_length(axes - position)
        torch.le(distance_m2, radius_m**2, out=is_member[number])
        torch.minimum(nearest_m2, distance_m2, out=nearest_m2)
        centre = nearest_m2.argmax(1)

    # The members of all balls follow each other. A ball starts at its first member, which exists,
    # since a ball has its centre. Take the first members; a ball with fewer repeats its first one.
    members = is_member.flatten().nonzero().squeeze(1)
    balls = torch.arange(centres * frames + 1, device=points.device)
    starts = torch.searchsorted(members, balls * rows)
    place = torch.arange(neighbours, device=points.device).expand(centres * frames, -1)
    place = place.masked_fill(place >= starts.diff()[:, None], 0)
    taken = members[starts[:-1, None] + place] % rows
    groups = torch.cat([chosen[:, :, None], taken.view(centres, frames, -1)], dim=2)
    groups = groups.transpose(0, 1).flatten(1)
    return order.gather(1, groups).view(frames, centres, -1)


def squared_length(axes: Tensor) -> Tensor:
    """Return x² + y² + z² of `axes` [3,...], with the same rounding on each device."""
    x2, y2, z2 = axes.square()
    return x2.add_(y2).add_(z2)


def position_hash(points: Tensor) -> Tensor:
    """Return an integer for (|x|, y, z) of each point, float32 [...,3] → int64 [...].

    Numbers of close positions differ at random.
    """
    x, y, z = points.unbind(-1)
    number = torch.zeros(x.shape, dtype=torch.int64, device=x.device)
    for axis in (x.abs(), y, z):
        number = (number ^ axis.contiguous().view(torch.int32)) * HASH_FACTOR
        number = number ^ (number >> 32)
    return number


class PointNet2(nn.Module):
    """Set abstractions around the centres of each frame, and over the complete frame.

    With two levels and width 1 the channels are those of Qi et al.: 64-64-128 and 128-128-256, over
    the complete frame 256-512-1024, and then 512 and 256.
    """

    def __init__(self, features: int, options: Options) -> None:
        super().__init__()
        self.options = options
        # Channels double from level to level: 64, 128, 256, …, times the width.
        levels = len(options.centres)
        channels = [max(1, round(options.width * 64 * 2**level)) for level in range(levels + 3)]
        self.levels = nn.ModuleList()
        inputs = NODE_FEATURES
        for level in range(levels):
            widths = [channels[level], channels[level], channels[level + 1]]
            self.levels.append(SetAbstraction(inputs, widths))
            inputs = channels[level + 1]

        # The complete frame is one set around the camera.
        widths = channels[levels:]
        self.whole = build_mlp(3 + inputs, *widths)
        self.head = build_mlp(*reversed(widths))
        self.read_out = nn.Linear(widths[0], features)

    def forward(self, batch: GraphBatch) -> Tensor:
        xyz = batch.xyz.to(self.read_out.weight.dtype)
        f = node_features(xyz, batch.cls, self.options.semantics)  # [P, NODE_FEATURES]
        assert batch.prepared is not None, "a batch for pointnet2 needs Options.prepare"
        occupied = batch.ptr.diff().nonzero().squeeze(1)
        first = batch.ptr[occupied].to(xyz.device, non_blocking=True)
        occupied = occupied.to(xyz.device, non_blocking=True)

        for layer, level in zip(
            self.levels, self.split_groups(batch.prepared[occupied]), strict=True
        ):
            rows = level + first[:, None, None]  # [B,M,1+n]
            centres = rows[:, :, 0].flatten()
            f = layer(xyz, f, centres, rows[:, :, 1:].flatten(0, 1))  # [BM,width]
            xyz = xyz[centres]
            first = torch.arange(len(occupied), device=xyz.device) * level.shape[1]
        h = self.whole(torch.cat([xyz / OFFSET_M, f], dim=1))  # [BM,1024 width]
        highest = h.unflatten(0, (-1, self.options.centres[-1])).amax(1)
        maximum = h.new_zeros(batch.frames, h.shape[1]).index_copy(0, occupied, highest)
        return self.read_out(self.head(maximum))

    def split_groups(self, prepared: Tensor) -> list[Tensor]:
        """Return the groups [B,M,1+n] of each level from those of :meth:`Options.prepare`."""
        levels = list(zip(self.options.centres, self.options.neighbours, strict=True))
        parts = torch.split(prepared, [m * (1 + n) for m, n in levels], dim=1)
        return [part.reshape(-1, m, 1 + n) for part, (m, n) in zip(parts, levels, strict=True)]
