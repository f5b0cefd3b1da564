"""Input of the spatial networks: B frames as images, or as concatenated point clouds."""

import dataclasses
from bisect import bisect_right
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Literal, Self

import numpy as np
import torch
from torch import Tensor, nn

Array = np.ndarray | Tensor
# Kind of frames that a network reads: a GraphBatch or an ImageBatch.
FrameKind = Literal["graph", "image"]
# Ending of the name of an array with the signs of a further column: of "normals", "normals_signs".
SIGNS = "_signs"
# Endings of the names of arrays that stay on the CPU: the first row of each frame, and signs.
# Reading them from a GPU would stall each step.
ON_CPU = ("ptr", SIGNS)
# Signs of xyz: x points to the right.
XYZ_SIGNS = torch.tensor([-1.0, 1.0, 1.0])


@dataclass(frozen=True)
class GraphBatch:
    """Points of B frames, N in total, with a symmetric graph per frame.

    Frame b has the rows ptr[b]:ptr[b+1]. A frame may have no points. There are E directed edges,
    two for each undirected one.
    """

    # Name → values of the points: those of the properties below, and the further columns of the
    # graph variant, [N,C].
    columns: Mapping[str, Tensor]
    ptr: Tensor  # int64 [B+1], on the CPU
    indices: Tensor  # int32 [E], row numbers of the neighbours, point by point (CSR)
    # Name of a further column → factors of its C components in the mirror image, 1 or -1: [C], on
    # the CPU.
    signs: Mapping[str, Tensor] = field(default_factory=dict)
    # [B, ...], what NetworkOptions.prepare returned for each frame; None for most networks.
    prepared: Tensor | None = None

    @property
    def xyz(self) -> Tensor:
        """The points [N,3] in metres, rectified camera frame (x right, y down, z forward)."""
        return self.columns["xyz"]

    @property
    def cls(self) -> Tensor:
        """The class of each point as Cityscapes trainId, uint8 [N]."""
        return self.columns["cls"]

    @property
    def degree(self) -> Tensor:
        """The number of each point's neighbours, [N]; a point is not its own neighbour."""
        return self.columns["degree"]

    @property
    def frames(self) -> int:
        """B, the number of frames."""
        return len(self.ptr) - 1

    def mirrored(self) -> Self:
        """Return the points mirrored left-right, with all their columns."""
        columns = dict(self.columns)
        for name, signs in {"xyz": XYZ_SIGNS, **self.signs}.items():
            columns[name] = _change_signs(columns[name], signs)
        return dataclasses.replace(self, columns=columns)

    @property
    def edge_index(self) -> Tensor:
        """The edges as in PyTorch Geometric, int64 [2,E]: row numbers of sources and of targets."""
        rows = torch.arange(len(self.degree), device=self.degree.device)
        target = rows.repeat_interleave(self.degree.long(), output_size=len(self.indices))
        return torch.stack([self.indices.long(), target])

    def blocks(self, points: int) -> Iterator["GraphBatch"]:
        """Split the batch on a CPU into blocks of whole frames with at most `points` points.

        A frame with more points is a block of its own. On a GPU the whole batch is a block, because
        few large operations are faster there.
        """
        if self.xyz.device.type != "cpu":
            yield self
            return
        # The first row and the first edge of each frame, and the ends.
        ptr = self.ptr.tolist()
        edges_before = nn.functional.pad(self.degree.long().cumsum(0), (1, 0))
        edge_ptr = edges_before[self.ptr].tolist()
        first = 0
        while first < self.frames:
            stop = max(first + 1, bisect_right(ptr, ptr[first] + points) - 1)
            rows = slice(ptr[first], ptr[stop])
            edges = slice(edge_ptr[first], edge_ptr[stop])
            yield GraphBatch(
                columns={name: values[rows] for name, values in self.columns.items()},
                ptr=self.ptr[first : stop + 1] - ptr[first],
                indices=self.indices[edges] - ptr[first],
                signs=self.signs,
                prepared=None if self.prepared is None else self.prepared[first:stop],
            )
            first = stop


def _change_signs(values: Tensor, signs: Tensor) -> Tensor:
    """Return a copy of values [N,C], in which components with a sign of -1 have the other sign."""
    changed = values.clone()
    for component, sign in enumerate(signs.tolist()):
        if sign < 0:
            changed[:, component].neg_()
    return changed


@dataclass(frozen=True)
class ImageBatch:
    """Images of B frames: RGB uint8 [B,H,W,3]."""

    image: Tensor

    def mirrored(self) -> Self:
        """Return the images mirrored left-right.

        This assumes that the optical axis is in the middle of the image. KITTI's is within 2 %.
        """
        return dataclasses.replace(self, image=self.image.flip(2))


Batch = GraphBatch | ImageBatch


def from_arrays(arrays: Mapping[str, Array], device: torch.device | str = "cpu") -> Batch:
    """Return a batch on `device` from arrays by name.

    The names are those in pipeline/graphs/graph_file.py, and `prepared`. A further column of the
    points comes with its signs, see SIGNS. Arrays of other names are ignored.
    """
    tensors = {}
    for name, array in arrays.items():
        tensors[name] = torch.as_tensor(array)
        if not name.endswith(ON_CPU):
            tensors[name] = tensors[name].to(device, non_blocking=True)
    if "image" in tensors:
        return ImageBatch(tensors["image"])
    signs = {}
    for name, values in tensors.items():
        if name.endswith(SIGNS):
            signs[name.removesuffix(SIGNS)] = values
    return GraphBatch(
        columns={name: tensors[name] for name in ("xyz", "cls", "degree", *signs)},
        ptr=tensors["ptr"],
        indices=tensors["indices"],
        signs=signs,
        prepared=tensors.get("prepared"),
    )
