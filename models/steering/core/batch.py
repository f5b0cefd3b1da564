"""Input of the spatial networks: B frames as images, or as concatenated point clouds."""

import dataclasses
from bisect import bisect_right
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Literal, Self

import numpy as np
import torch
from torch import Tensor, nn

Array = np.ndarray | Tensor
Kind = Literal["graph", "pointnet2", "image"]
"""Kinds of input: GraphBatch, SetBatch, ImageBatch."""


class _Movable:
    def to(self, device: torch.device | str) -> Self:
        """Return a copy on `device`. `ptr` stays on the CPU: reading it from a GPU would stall each step."""
        moved = {name: _move(value, device) for name, value in vars(self).items() if name != "ptr"}
        return dataclasses.replace(self, **moved)  # type: ignore[type-var]


def _move(value: Any, device: torch.device | str) -> Any:
    if isinstance(value, tuple):
        return tuple(_move(item, device) for item in value)
    return value.to(device) if isinstance(value, _Movable) else value.to(device, non_blocking=True)


@dataclass(frozen=True)
class _Points(_Movable):
    """Points of B frames, N in all.

    xyz [N,3] metres, rectified camera frame (x right, y down, z forward); cls uint8 [N], trainId;
    ptr int64 [B+1], frame b has the rows ptr[b]:ptr[b+1].
    """

    xyz: Tensor
    cls: Tensor
    ptr: Tensor

    def mirrored(self) -> Self:
        """Return the frames mirrored left-right."""
        return dataclasses.replace(self, xyz=self.xyz * self.xyz.new_tensor([-1.0, 1.0, 1.0]))


@dataclass(frozen=True)
class GraphBatch(_Points):
    """Points with a symmetric graph per frame: E directed edges, two for each undirected one.

    degree [N], neighbours of each point, itself excluded; indices int32 or int64 [E], row numbers of the neighbours of
    point 0, of point 1, … (CSR).
    """

    degree: Tensor
    indices: Tensor

    @property
    def frames(self) -> int:
        """B, the number of frames."""
        return len(self.ptr) - 1

    def blocks(self, points: int) -> Iterator[Self]:
        """Split the batch into blocks of complete frames with at most `points` points, or of one larger frame."""
        ptr = self.ptr.tolist()
        ends = nn.functional.pad(self.degree.long().cumsum(0), (1, 0))[self.ptr].tolist()  # edges before each frame
        first = 0
        while first < self.frames:
            last = max(first + 1, bisect_right(ptr, ptr[first] + points) - 1)
            rows = slice(ptr[first], ptr[last])
            yield type(self)(
                self.xyz[rows],
                self.cls[rows],
                self.ptr[first : last + 1] - ptr[first],
                self.degree[rows],
                self.indices[ends[first] : ends[last]] - ptr[first],
            )
            first = last


@dataclass(frozen=True)
class Level(_Movable):
    """One sampling and grouping of B frames' points: M centres with n neighbours each.

    centres int64 [M], neighbours int64 [M,n]: row numbers in the batch's points, or in the previous level's centres;
    ptr int64 [B+1], frame b has the rows ptr[b]:ptr[b+1].
    """

    centres: Tensor
    neighbours: Tensor
    ptr: Tensor


@dataclass(frozen=True)
class SetBatch(_Points):
    """Points with PointNet++'s neighbourhoods."""

    levels: tuple[Level, ...]


@dataclass(frozen=True)
class ImageBatch(_Movable):
    """Images of B frames: RGB uint8 [B,H,W,3]."""

    image: Tensor

    def mirrored(self) -> Self:
        """Return the images mirrored left-right. Assumes the optical axis in the middle; KITTI's is within 2 %."""
        return dataclasses.replace(self, image=self.image.flip(2))


Batch = GraphBatch | SetBatch | ImageBatch


def from_arrays(arrays: Mapping[str, Array]) -> Batch:
    """Return a batch of arrays or tensors by name; other names are ignored.

    `image`; or xyz, cls, ptr with degree and indices; or xyz, cls, ptr with centres_l, neighbours_l, centres_l_ptr of
    the levels l = 1, 2, …
    """
    if "image" in arrays:
        return ImageBatch(torch.as_tensor(arrays["image"]))
    if "degree" in arrays:
        return GraphBatch(*_tensors(arrays, "xyz", "cls", "ptr", "degree", "indices"))
    xyz, cls, ptr = _tensors(arrays, "xyz", "cls", "ptr")
    count = sum(name.startswith("neighbours_") for name in arrays)
    levels = [_tensors(arrays, f"centres_{n}", f"neighbours_{n}", f"centres_{n}_ptr") for n in range(1, count + 1)]
    return SetBatch(xyz, cls, ptr, tuple(Level(*level) for level in levels))


def _tensors(arrays: Mapping[str, Array], *names: str) -> list[Tensor]:
    return [torch.as_tensor(arrays[name]) for name in names]
