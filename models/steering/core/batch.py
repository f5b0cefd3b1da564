"""Input of the spatial networks: B frames as images, or as concatenated point clouds."""

import dataclasses
from bisect import bisect_right
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Literal, NamedTuple, Self

import numpy as np
import torch
from torch import Tensor, nn

Array = np.ndarray | Tensor
FrameKind = Literal["graph", "pointnet2", "image"]  # GraphBatch, SetBatch, ImageBatch


@dataclass(frozen=True)
class _Points:
    """Points of B frames, N in all.

    xyz [N,3] metres, rectified camera frame (x right, y down, z forward); cls uint8 [N], trainId;
    ptr int64 [B+1] on the CPU, frame b has the rows ptr[b]:ptr[b+1], none if it has no points.
    """

    xyz: Tensor
    cls: Tensor
    ptr: Tensor

    @property
    def frames(self) -> int:
        """B, the number of frames."""
        return len(self.ptr) - 1

    def mirrored(self) -> Self:
        return dataclasses.replace(self, xyz=torch.cat([-self.xyz[:, :1], self.xyz[:, 1:]], dim=1))


@dataclass(frozen=True)
class GraphBatch(_Points):
    """Points with a symmetric graph per frame: E directed edges, two for each undirected one.

    degree [N], neighbours of each point, itself excluded; indices int32 [E], their row numbers,
    point by point (CSR).
    """

    degree: Tensor
    indices: Tensor

    @property
    def edge_index(self) -> Tensor:
        """The edges int64 [2,E] as PyTorch Geometric has them: from row numbers, to row numbers."""
        to = torch.arange(len(self.degree), device=self.degree.device)
        to = to.repeat_interleave(self.degree.long(), output_size=len(self.indices))
        return torch.stack([self.indices.long(), to])

    def blocks(self, points: int) -> Iterator["GraphBatch"]:
        """Split the batch on a CPU into blocks of whole frames with at most `points` points, or of
        one larger frame.
        """
        if self.xyz.device.type != "cpu":
            yield self  # few launches
            return
        # before each frame
        edges = nn.functional.pad(self.degree.long().cumsum(0), (1, 0))[self.ptr].tolist()
        ptr, first = self.ptr.tolist(), 0
        while first < len(ptr) - 1:
            last = max(first + 1, bisect_right(ptr, ptr[first] + points) - 1)
            start, rows = ptr[first], slice(ptr[first], ptr[last])
            indices = self.indices[edges[first] : edges[last]] - start
            ends = self.ptr[first : last + 1] - start
            yield GraphBatch(self.xyz[rows], self.cls[rows], ends, self.degree[rows], indices)
            first = last


class Level(NamedTuple):
    """A level of B frames' points: M centres with n neighbours each.

    centres int32 [M], neighbours int32 [M,n]: row numbers in the batch's points, or in the previous
    level's centres; ptr int64 [B+1] on the CPU, frame b has the rows ptr[b]:ptr[b+1].
    """

    centres: Tensor
    neighbours: Tensor
    ptr: Tensor


@dataclass(frozen=True)
class SetBatch(_Points):
    """Points with PointNet++'s neighbourhoods."""

    levels: tuple[Level, ...]


@dataclass(frozen=True)
class ImageBatch:
    """Images of B frames: RGB uint8 [B,H,W,3]."""

    image: Tensor

    def mirrored(self) -> Self:
        """Return the images mirrored left-right. Assumes the optical axis in the middle; KITTI's is
        within 2 %.
        """
        return dataclasses.replace(self, image=self.image.flip(2))


Batch = GraphBatch | SetBatch | ImageBatch


def from_arrays(arrays: Mapping[str, Array], device: torch.device | str = "cpu") -> Batch:
    """Return a batch on `device` of arrays by name, as pipeline/graphs/graph_file.py names them;
    others are ignored.
    """
    there = {name: torch.as_tensor(array) for name, array in arrays.items()}
    # Pointers stay on the CPU: reading them from a GPU would stall each step.
    there |= {
        name: there[name].to(device, non_blocking=True)
        for name in there
        if not name.endswith("ptr")
    }
    if "image" in there:
        return ImageBatch(there["image"])
    points = there["xyz"], there["cls"], there["ptr"]
    if "degree" in there:
        return GraphBatch(*points, there["degree"], there["indices"])
    levels: list[Level] = []
    while (name := f"centres_{len(levels) + 1}") in there:
        levels.append(
            Level(there[name], there[f"neighbours_{len(levels) + 1}"], there[f"{name}_ptr"])
        )
    return SetBatch(*points, tuple(levels))
