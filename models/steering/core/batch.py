"""Input of the spatial networks: B frames as images, or as concatenated point clouds."""

import dataclasses
from bisect import bisect_right
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Literal, Self

import numpy as np
import torch
from torch import Tensor, nn

Array = np.ndarray | Tensor
# Kind of frames that a network reads: a GraphBatch or an ImageBatch.
FrameKind = Literal["graph", "image"]


@dataclass(frozen=True)
class GraphBatch:
    """Points of B frames, N in total, with a symmetric graph per frame.

    Frame b has the rows ptr[b]:ptr[b+1]. A frame may have no points. There are E directed edges,
    two for each undirected one.
    """

    xyz: Tensor  # [N,3] metres, rectified camera frame (x right, y down, z forward)
    cls: Tensor  # uint8 [N], class of each point as Cityscapes trainId
    ptr: Tensor  # int64 [B+1], on the CPU
    degree: Tensor  # [N], number of each point's neighbours; a point is not its own neighbour
    indices: Tensor  # int32 [E], row numbers of the neighbours, point by point (CSR)
    # [B, ...], what NetworkOptions.prepare returned for each frame; None for most networks.
    prepared: Tensor | None = None

    @property
    def frames(self) -> int:
        """B, the number of frames."""
        return len(self.ptr) - 1

    def mirrored(self) -> Self:
        """Return the points mirrored left-right."""
        x = self.xyz[:, :1]
        return dataclasses.replace(self, xyz=torch.cat([-x, self.xyz[:, 1:]], dim=1))

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
                xyz=self.xyz[rows],
                cls=self.cls[rows],
                ptr=self.ptr[first : stop + 1] - ptr[first],
                degree=self.degree[rows],
                indices=self.indices[edges] - ptr[first],
                prepared=None if self.prepared is None else self.prepared[first:stop],
            )
            first = stop


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

    The names are those in pipeline/graphs/graph_file.py, and `prepared`. Arrays of other names are
    ignored.
    """
    tensors = {}
    for name, array in arrays.items():
        tensors[name] = torch.as_tensor(array)
        # Pointers stay on the CPU: reading them from a GPU would stall each step.
        if not name.endswith("ptr"):
            tensors[name] = tensors[name].to(device, non_blocking=True)
    if "image" in tensors:
        return ImageBatch(tensors["image"])
    points = (tensors["xyz"], tensors["cls"], tensors["ptr"])
    return GraphBatch(*points, tensors["degree"], tensors["indices"], tensors.get("prepared"))
