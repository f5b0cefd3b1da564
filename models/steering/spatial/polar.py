"""A polar map of the road ahead, read by a small convolutional network.

An error of depth moves a point along its bearing, and bearings are exact. So each cell of the map
is an interval of bearings and an interval of distances. Far intervals of distances are longer, as
errors are larger there.
"""

import math

import torch
from torch import Tensor, nn

from models.steering.core.batch import GraphBatch
from models.steering.core.options import NetworkOptions, Sizes, Widths
from pipeline.camera import classes

# Number of bearings. It is odd, so rounding is symmetric around straight ahead, and mirroring
# reverses the order of the bearings exactly.
BEARINGS = 33
# Angle in radians that all bearings cover together. KITTI's camera covers 80 degrees.
FIELD_RAD = math.radians(90)
# Number of ranges. Each is longer than the one before it by the same factor.
RANGES = 12
# Distance in metres at which the first range begins.
NEAR_M = 4.0
# Distance in metres at which the last range ends.
FAR_M = 40.0
# Kinds of points that a cell counts.
ROAD, GROUND, OBSTACLE, VOID = range(4)
KINDS = 4
# Channels of a cell: the shares of road, other ground and obstacles among its points, and 1 if it
# has no points.
CHANNELS = 4


def polar_map(batch: GraphBatch) -> Tensor:
    """Return the map of each frame, float32 [B, CHANNELS, RANGES, BEARINGS].

    Bearings are from left to right, ranges from near to far. A point of class void is in the number
    of a cell's points, but in none of the three shares. Points outside of the map have no effect.
    """
    # The column of a point follows from its bearing, the row from the logarithm of its distance.
    x, _, z = batch.xyz.unbind(1)
    column = (torch.atan2(x, z) * (BEARINGS / FIELD_RAD)).round() + BEARINGS // 2
    range_m = torch.hypot(x, z).clamp_min(NEAR_M / 2)
    row = ((range_m / NEAR_M).log() * (RANGES / math.log(FAR_M / NEAR_M))).floor()
    inside = (column >= 0) & (column < BEARINGS) & (row >= 0) & (row < RANGES)

    # Cells are numbered through all frames. A point outside of the map gets a cell at its edge, and
    # is not counted there.
    points = torch.arange(len(x), device=x.device)
    ends = batch.ptr.to(x.device, non_blocking=True)[1:]
    frame = torch.searchsorted(ends, points, right=True)
    row = row.clamp(0, RANGES - 1).long()
    column = column.clamp(0, BEARINGS - 1).long()
    cell = (frame * RANGES + row) * BEARINGS + column

    ground = torch.stack([batch.cls == number for number in classes.GROUND]).any(0)
    kind = torch.where(ground, GROUND, OBSTACLE)
    kind = kind.masked_fill(batch.cls == classes.ROAD, ROAD)
    kind = kind.masked_fill(batch.cls >= classes.COUNT, VOID)

    # Counts are exact in any order of additions, so the map is deterministic on a GPU, too.
    counts = torch.zeros(batch.frames * RANGES * BEARINGS * KINDS, device=cell.device)
    counts = counts.scatter_add(0, cell * KINDS + kind, inside.float())
    counts = counts.view(-1, RANGES, BEARINGS, KINDS)

    total = counts.sum(3, keepdim=True)
    shares = counts[..., :VOID] / total.clamp_min(1)
    empty = (total == 0).float()
    return torch.cat([shares, empty], dim=3).permute(0, 3, 1, 2)


class Polar(nn.Module):
    """Polar map, convolutions with `widths` channels, and a dense layer."""

    def __init__(self, features: int, widths: tuple[int, ...]) -> None:
        super().__init__()
        self.convolutions = nn.Sequential()
        inputs = CHANNELS
        height = RANGES
        width = BEARINGS
        stride = 1
        for outputs in widths:
            self.convolutions.append(nn.Conv2d(inputs, outputs, 3, stride, padding=1))
            self.convolutions.append(nn.ReLU())
            inputs = outputs
            height = math.ceil(height / stride)
            width = math.ceil(width / stride)
            stride = 2  # each convolution but the first halves the map
        self.read_out = nn.Linear(inputs * height * width, features)

    def forward(self, batch: GraphBatch) -> Tensor:
        return self._read(polar_map(batch))

    def with_mirrored(self, batch: GraphBatch) -> tuple[Tensor, ...]:
        """Return `forward` of the frames and of their mirror images, each [B,F]."""
        frames = polar_map(batch)
        return self._read(torch.cat([frames, frames.flip(3)])).chunk(2)

    def _read(self, frames: Tensor) -> Tensor:
        maps = self.convolutions(frames.to(self.read_out.weight.dtype)).flatten(1)
        return self.read_out(maps)


class Options(NetworkOptions):
    kind = "graph"
    widths: Widths = (16, 24, 32, 24)

    def build(self, sizes: Sizes) -> nn.Module:
        return Polar(sizes.features, self.widths)
