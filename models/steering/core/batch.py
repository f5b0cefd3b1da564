"""Frames as the spatial networks see them: images, or many point clouds side by side."""

import dataclasses
from bisect import bisect_right
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Literal, Self

import numpy as np
import torch
from torch import Tensor, nn

Array = np.ndarray | Tensor
Kind = Literal["graph", "pointnet2", "image"]
"""What the frames of an input are: GraphBatch, SetBatch or ImageBatch."""


@dataclass(frozen=True)
class GraphBatch:
    """B frames' clouds and symmetric graphs, concatenated: N points, E directed edges (each undirected one twice).

    xyz [N,3] metres, rectified camera frame (x right, y down, z forward); cls uint8 [N], trainId;
    ptr int64 [B+1], frame b owns the rows ptr[b]:ptr[b+1]; degree [N], neighbours without the node itself;
    indices int32 or int64 [E], neighbours' row numbers in the batch, node after node (CSR).
    """

    xyz: Tensor
    cls: Tensor
    ptr: Tensor
    degree: Tensor
    indices: Tensor

    @classmethod
    def of_arrays(cls, arrays: Mapping[str, Array]) -> Self:
        """Return the batch of the arrays of these names, which may be tensors; others are ignored."""
        return cls(**{field.name: torch.as_tensor(arrays[field.name]) for field in dataclasses.fields(cls)})

    @property
    def frames(self) -> int:
        """B, the number of frames."""
        return len(self.ptr) - 1

    def to(self, device: torch.device | str) -> Self:
        """Return the batch on `device`, but for `ptr`: a step that asks a GPU where frames begin waits for it."""
        tensors = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        del tensors["ptr"]
        moved = {name: tensor.to(device, non_blocking=True) for name, tensor in tensors.items()}
        return dataclasses.replace(self, **moved)

    def blocks(self, points: int) -> Iterator[Self]:
        """Cut the batch in blocks of whole frames: as many as have `points` points at most, and at least one."""
        ptr = self.ptr.tolist()
        ends = nn.functional.pad(self.degree.long().cumsum(0), (1, 0))[self.ptr].tolist()  # of the frames' edges
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

    def mirrored(self) -> Self:
        """Return the frames as seen in a mirror, left for right."""
        return dataclasses.replace(self, xyz=flipped(self.xyz))


@dataclass(frozen=True)
class Level:
    """One sampling and grouping of B frames' points: M centres with n neighbours each.

    centres int64 [M], neighbours int64 [M,n]: row numbers in the batch's points, or in the centres of the level before;
    ptr int64 [B+1], frame b owns the rows ptr[b]:ptr[b+1].
    """

    centres: Tensor
    neighbours: Tensor
    ptr: Tensor

    def to(self, device: torch.device | str) -> Self:
        """Return the level on `device`, but for `ptr`."""
        centres, neighbours = (tensor.to(device, non_blocking=True) for tensor in (self.centres, self.neighbours))
        return dataclasses.replace(self, centres=centres, neighbours=neighbours)


@dataclass(frozen=True)
class SetBatch:
    """B frames' clouds with PointNet++'s neighbourhoods; xyz, cls and ptr as in GraphBatch."""

    xyz: Tensor
    cls: Tensor
    ptr: Tensor
    levels: tuple[Level, ...]

    @classmethod
    def of_arrays(cls, arrays: Mapping[str, Array]) -> Self:
        """Return the batch of xyz, cls, ptr, and of centres_1, neighbours_1, centres_1_ptr, centres_2, …"""
        xyz, trainid, ptr = (torch.as_tensor(arrays[name]) for name in ("xyz", "cls", "ptr"))
        count = sum(name.startswith("neighbours_") for name in arrays)
        levels = tuple(
            Level(*(torch.as_tensor(arrays[name]) for name in (f"centres_{n}", f"neighbours_{n}", f"centres_{n}_ptr")))
            for n in range(1, count + 1)
        )
        return cls(xyz, trainid, ptr, levels)

    def to(self, device: torch.device | str) -> Self:
        """Return the batch on `device`, but for what points: a step that asks a GPU where frames begin waits for it."""
        levels = tuple(level.to(device) for level in self.levels)
        xyz, cls = (tensor.to(device, non_blocking=True) for tensor in (self.xyz, self.cls))
        return dataclasses.replace(self, xyz=xyz, cls=cls, levels=levels)

    def mirrored(self) -> Self:
        """Return the frames as seen in a mirror, left for right."""
        return dataclasses.replace(self, xyz=flipped(self.xyz))


@dataclass(frozen=True)
class ImageBatch:
    """B frames' images: RGB uint8 [B,H,W,3]."""

    image: Tensor

    def to(self, device: torch.device | str) -> Self:
        """Return the batch on `device`."""
        return dataclasses.replace(self, image=self.image.to(device, non_blocking=True))

    def mirrored(self) -> Self:
        """Return the frames as seen in a mirror; KITTI's optical axis meets the image within 2 % of its middle."""
        return dataclasses.replace(self, image=self.image.flip(2))


Batch = GraphBatch | SetBatch | ImageBatch


def of_arrays(arrays: Mapping[str, Array]) -> Batch:
    """Return the batch that the arrays' names tell of; arrays of other names are ignored."""
    if "image" in arrays:
        return ImageBatch(torch.as_tensor(arrays["image"]))
    return GraphBatch.of_arrays(arrays) if "degree" in arrays else SetBatch.of_arrays(arrays)


def flipped(xyz: Tensor) -> Tensor:
    """Return points [N,3] of the camera frame with x as -x."""
    return xyz * xyz.new_tensor([-1.0, 1.0, 1.0])
