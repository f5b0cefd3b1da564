"""Read graph files, data/graphs/<variant>/<drive>.h5: their kind, and runs of frames as arrays of a network's input.

`graph`: xyz float32 [N,3], cls uint8 [N], ptr int64 [B+1], degree uint8 [N], indices int32 [E].
`pointnet2`: xyz, cls, ptr, and for each level l from 1: centres_l int64 [M], neighbours_l int64 [M,n], centres_l_ptr
int64 [B+1]. `image`: uint8 [B,H,W,3]. In files, row numbers count from 0 in each frame; in arrays, from 0 in the batch.
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cached_property
from itertools import accumulate, count, pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from pipeline.base import store
from pipeline.base.errors import InputError

if TYPE_CHECKING:
    from torch_geometric.data import Data

Arrays = dict[str, np.ndarray]


class Motion(NamedTuple):
    """Measured motion of the car since the previous frame, left and forward +; all 0 where it is not valid."""

    yaw_rate_radps: np.ndarray  # float32 [G]
    speed_mps: np.ndarray  # float32 [G]
    valid: np.ndarray  # uint8 [G]


class Graphs:
    """An open graph file with G frames. Pointers are read once."""

    def __init__(self, file: store.DriveReader) -> None:
        self._file = file
        self.path = file.path
        self.frame = file.frame  # int32 [G], KITTI frame numbers, ascending
        self.time_s = file.time_s  # float64 [G]

    @cached_property
    def contents(self) -> dict[str, Any]:
        """Kind of the frames, and levels or image_size: arguments of `steering_net.build`."""
        if "image" in self._file:
            height, width = self._file.shape("image")[1:3]
            return {"kind": "image", "image_size": (height, width)}
        if "degree" in self._file:
            return {"kind": "graph"}
        return {"kind": "pointnet2", "levels": next(n for n in count() if f"centres_{n + 1}" not in self._file)}

    @property
    def points_per_frame(self) -> float:
        """Mean number of points; 0 for images and for a file without frames."""
        return int(self._ptr["xyz"][-1]) / max(len(self.frame), 1) if "xyz" in self._ptr else 0.0

    @property
    def empty(self) -> bool:
        """Whether the file has no point or image."""
        return not any(starts[-1] for starts in self._ptr.values())

    @cached_property
    def motions(self) -> tuple[str, ...]:
        """Kinds of measured motion in the file: visual, lidar."""
        return tuple(kind for kind in ("visual", "lidar") if f"{kind}_valid" in self._file)

    def motion(self, kind: str) -> Motion:
        """Return the motion of this kind for all frames. Raises InputError if the file has none."""
        if kind not in self.motions:
            found = ", ".join(self.motions) or "none"
            fix = f"Add {kind} to motion.kinds in the params file and run dvc repro"
            raise InputError(f"no motion of kind {kind} (found: {found})", self.path, fix)
        return Motion(*(self._file[f"{kind}_{name}"] for name in Motion._fields))

    @cached_property
    def _ptr(self) -> dict[str, np.ndarray]:
        """Array → int64 [G+1], first row of each frame."""
        if self.contents["kind"] == "image":
            return {"image": np.arange(len(self.frame) + 1)}
        ptr = self._file["ptr"]
        if self.contents["kind"] == "graph":
            return {"xyz": ptr, "cls": ptr, "degree": ptr, "indices": self._file["indices_ptr"]}
        levels: dict[str, np.ndarray] = {}
        for level in range(1, self.contents["levels"] + 1):
            centres = f"centres_{level}"
            levels |= dict.fromkeys((centres, f"neighbours_{level}"), self._file[f"{centres}_ptr"])
        return {"xyz": ptr, "cls": ptr, **levels}

    def read(self, start: int, stop: int) -> Arrays:
        """Return the arrays of frames [start, stop). Raises InputError if a graph in the file is inconsistent."""
        arrays = {}
        for name, starts in self._ptr.items():
            ptr = starts[start : stop + 1]
            rows = self._file.rows(name, ptr[0], ptr[-1])
            if target := _target(name):
                first = self._ptr[target][start : stop + 1]
                rows = self._renumber(name, rows, ptr - ptr[0], first - first[0])
            arrays[name] = rows
            if name in ("xyz", "indices") or name.startswith("centres_"):
                arrays["ptr" if name == "xyz" else f"{name}_ptr"] = ptr - ptr[0]
        if "degree" in arrays:
            edges = np.concatenate([[0], np.cumsum(arrays["degree"], dtype=np.int64)])
            if not np.array_equal(edges[arrays["ptr"]], arrays.pop("indices_ptr")):
                raise self._damaged("the sum of degree is not the number of indices")
        return arrays

    def to_pyg(self, number: int, steering_rad: float = np.nan) -> "Data":
        """Return the graph of frame `number` for PyTorch Geometric, which is installed with '.[dev]'.

        pos [N,3] in metres, x [N,25] node features with λ = 1, edge_index [2,E], both directions of each edge, and y
        [1], the angle. Raises InputError if the file has no such frame or holds no kNN graphs.
        """
        import torch
        from torch_geometric.data import Data

        from models.steering.core.features import node_features

        if self.contents["kind"] != "graph":
            raise InputError(f"expected kNN graphs, got {describe(self.contents)}", self.path)
        row = self._file.row_of(number)
        arrays = {name: torch.from_numpy(array) for name, array in self.read(row, row + 1).items()}
        points = torch.arange(len(arrays["xyz"]))
        return Data(
            pos=arrays["xyz"],
            x=node_features(arrays["xyz"], arrays["cls"], semantics=1.0),
            edge_index=torch.stack([points.repeat_interleave(arrays["degree"].long()), arrays["indices"].long()]),
            y=torch.tensor([steering_rad], dtype=torch.float32),
        )

    def _renumber(self, name: str, rows: np.ndarray, ptr: np.ndarray, first: np.ndarray) -> np.ndarray:
        """Return row numbers that count from 0 in the batch. Raises InputError if one exceeds its frame.

        Args:
            rows: numbers that count from 0 in each frame.
            ptr: [B+1], each frame's first row in `rows`.
            first: [B+1], each frame's first row in the array that they count.
        """
        dtype = np.int32 if name == "indices" else np.int64  # for sparse matrices; for indexing
        numbers = np.empty(rows.shape, dtype)
        for (start, stop), (shift, end) in zip(pairwise(ptr.tolist()), pairwise(first.tolist()), strict=True):
            if stop > start and rows[start:stop].max(initial=0) >= end - shift:
                raise self._damaged(f"{name} exceeds the {end - shift} rows of a frame")
            np.add(rows[start:stop], shift, out=numbers[start:stop], dtype=dtype, casting="same_kind")
        return numbers

    def _damaged(self, fault: str) -> InputError:
        return InputError(f"the file is damaged ({fault})", self.path, store.fix_hint(self.path, "graphs"))


@contextmanager
def open_graphs(path: str | Path) -> Iterator[Graphs]:
    """Open a graph file. Raises InputError if it is missing, damaged or written by another stage."""
    with store.DriveReader(Path(path), stage="graphs") as file:
        yield Graphs(file)


def describe(contents: Mapping[str, Any]) -> str:
    """Return :attr:`Graphs.contents` in words."""
    if contents["kind"] == "image":
        height, width = contents["image_size"]
        return f"images of {height} x {width} pixels"
    if contents["kind"] == "pointnet2":
        return f"points with PointNet++ neighbourhoods in {contents['levels']} levels"
    return "kNN graphs"


def concatenate(parts: Sequence[Arrays]) -> Arrays:
    """Concatenate runs of frames of one kind."""
    if len(parts) == 1:
        return parts[0]
    batch = {}
    for name in parts[0]:
        arrays = [part[name] for part in parts]
        if target := _target(name):
            before = accumulate((len(part[target]) for part in parts), initial=0)
            arrays = [array + first for array, first in zip(arrays, before, strict=False)]  # keeps the dtype
        if name.endswith("ptr"):
            arrays = [array[:-1] for array in arrays[:-1]] + arrays[-1:]
        batch[name] = np.concatenate(arrays)
    return batch


def _target(name: str) -> str | None:
    """Return the array that the row numbers in array `name` refer to; None if it holds no row numbers."""
    if name in ("ptr", "indices"):
        return "xyz"
    if name.endswith("_ptr"):
        return name.removesuffix("_ptr")
    array, _, level = name.partition("_")
    if array in ("centres", "neighbours"):
        return "xyz" if level == "1" else f"centres_{int(level) - 1}"
    return None
