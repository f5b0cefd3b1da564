"""A polar map of the road ahead, read by a small convolutional network.

Errors of depth are radial and bearings are exact. So its cells are bearings, and ranges that grow
with the distance.
"""

import math
from itertools import pairwise

import torch
from torch import Tensor, nn

from models.steering.core.batch import GraphBatch
from models.steering.core.options import NetworkOptions, Sizes, Widths
from pipeline.camera import classes

# odd: then rounding is symmetric around straight ahead, and mirroring reverses the bearings exactly
BEARINGS = 33
FIELD_RAD = math.radians(90)  # KITTI's camera sees 80 degrees
RANGES = 12
NEAR_M, FAR_M = 4.0, 40.0
ROAD, GROUND, OBSTACLE, VOID = range(4)
# share of road, other ground and obstacles among the points of a cell; 1 for a cell without points
CHANNELS = 4


def polar_map(batch: GraphBatch) -> Tensor:
    """Return the map of each frame, float32 [B, CHANNELS, RANGES, BEARINGS], from left to right and
    from near to far.

    Void points count as none of the three kinds; points outside of the map have no effect.
    """
    x, _, z = batch.xyz.unbind(1)
    column = (torch.atan2(x, z) * (BEARINGS / FIELD_RAD)).round() + BEARINGS // 2
    range_m = torch.hypot(x, z).clamp_min(NEAR_M / 2)
    row = ((range_m / NEAR_M).log() * (RANGES / math.log(FAR_M / NEAR_M))).floor()
    inside = (column >= 0) & (column < BEARINGS) & (row >= 0) & (row < RANGES)
    points = torch.arange(len(x), device=x.device)
    frame = torch.searchsorted(batch.ptr.to(x.device, non_blocking=True)[1:], points, right=True)
    cell = (frame * RANGES + row.clamp(0, RANGES - 1).long()) * BEARINGS + column.clamp(
        0, BEARINGS - 1
    ).long()
    ground = torch.stack([batch.cls == number for number in classes.GROUND]).any(0)
    kind = torch.where(ground, GROUND, OBSTACLE).masked_fill(batch.cls == classes.ROAD, ROAD)
    kind = kind.masked_fill(batch.cls >= classes.COUNT, VOID)
    # Sums of ones are exact in any order, so the map is deterministic on a GPU, too.
    counts = torch.zeros(batch.frames * RANGES * BEARINGS * 4, device=cell.device)
    counts = counts.scatter_add(0, cell * 4 + kind, inside.float()).view(-1, RANGES, BEARINGS, 4)
    total = counts.sum(3, keepdim=True)
    shares = counts[..., :VOID] / total.clamp_min(1)
    return torch.cat([shares, (total == 0).float()], dim=3).permute(0, 3, 1, 2)


class Polar(nn.Module):
    """Polar map → convolutions of `widths` channels, with stride 2 but the first → one dense
    layer.
    """

    def __init__(self, features: int, widths: tuple[int, ...]) -> None:
        super().__init__()
        self.convolutions = nn.Sequential()
        height, width = RANGES, BEARINGS
        for number, (before, after) in enumerate(pairwise((CHANNELS, *widths))):
            stride = 2 if number else 1
            self.convolutions.extend([nn.Conv2d(before, after, 3, stride, padding=1), nn.ReLU()])
            height, width = -(-height // stride), -(-width // stride)
        self.read_out = nn.Linear(widths[-1] * height * width, features)

    def forward(self, batch: GraphBatch) -> Tensor:
        return self._read(polar_map(batch))

    def both(self, batch: GraphBatch) -> tuple[Tensor, ...]:
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
