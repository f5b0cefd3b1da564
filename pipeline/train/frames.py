"""Reading graph files: what kind of frames one holds, and runs of them as the arrays that networks expect.

Three kinds. `graph`: xyz float32 [N,3], cls uint8 [N], ptr int64 [B+1], degree uint8 [N], indices int32 [E].
`pointnet2`: xyz, cls, ptr, and for each level l from 1: centres_l int64 [M], neighbours_l int64 [M,n], centres_l_ptr
int64 [B+1]. `image`: uint8 [B,H,W,3]. Files number rows from 0 in each frame; arrays count on through all their frames.
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cached_property
from itertools import accumulate, count, pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from pipeline.base import store
from pipeline.base.errors import InputError

Arrays = dict[str, np.ndarray]


class Motion(NamedTuple):
    """What the car did since the frame before, left and forward +; all 0 where it is not valid."""

    yaw_rate_radps: np.ndarray  # float32 [G]
    speed_mps: np.ndarray  # float32 [G]
    valid: np.ndarray  # uint8 [G]


class Graphs:
    """An open graph file. What tells where frames begin is read once."""

    def __init__(self, file: store.DriveReader) -> None:
        self._file = file
        self.path = file.path
        self.frame = file.frame  # int32 [G], KITTI frame numbers, ascending
        self.time_s = file.time_s  # float64 [G]

    @cached_property
    def contents(self) -> dict[str, Any]:
        """What its frames are, as `steering_net.build` asks: kind, and levels or image_size."""
        if "image" in self._file:
            height, width = self._file.shape("image")[1:3]
            return {"kind": "image", "image_size": (height, width)}
        if "degree" in self._file:
            return {"kind": "graph"}
        return {"kind": "pointnet2", "levels": next(n for n in count() if f"centres_{n + 1}" not in self._file)}

    @property
    def points_per_frame(self) -> float:
        """The mean over its frames; 0 of images, and of a file without frames."""
        return int(self._ptr["xyz"][-1]) / max(len(self.frame), 1) if "xyz" in self._ptr else 0.0

    @property
    def empty(self) -> bool:
        """Whether all its frames together hold nothing: no point, or no image."""
        return not any(starts[-1] for starts in self._ptr.values())

    @cached_property
    def motions(self) -> tuple[str, ...]:
        """The kinds of measured motion that the file carries: visual, lidar."""
        return tuple(kind for kind in ("visual", "lidar") if f"{kind}_valid" in self._file)

    def motion(self, kind: str) -> Motion:
        """Return the motion of this kind, of all frames. Raises InputError if the file carries none."""
        if kind not in self.motions:
            raise InputError(
                f"{self.path} carries no motion: {kind} (it has {', '.join(self.motions) or 'none'}): "
                f"put {kind} into motion.kinds of the params file and run dvc repro"
            )
        return Motion(*(self._file[f"{kind}_{name}"] for name in Motion._fields))

    @cached_property
    def _ptr(self) -> dict[str, np.ndarray]:
        """Array → int64 [G+1], where each frame's rows begin."""
        if self.contents["kind"] == "image":
            return {"image": np.arange(len(self.frame) + 1)}
        ptr = self._file["ptr"]
        if self.contents["kind"] == "graph":
            return {"xyz": ptr, "cls": ptr, "degree": ptr, "indices": self._file["indices_ptr"]}
        of_levels: dict[str, np.ndarray] = {}
        for level in range(1, self.contents["levels"] + 1):
            centres = f"centres_{level}"
            of_levels |= dict.fromkeys((centres, f"neighbours_{level}"), self._file[f"{centres}_ptr"])
        return {"xyz": ptr, "cls": ptr, **of_levels}

    def read(self, start: int, stop: int) -> Arrays:
        """Return the arrays of frames [start, stop). Raises InputError if one of them is not what a graph can be."""
        arrays = {}
        for name, starts in self._ptr.items():
            ptr = starts[start : stop + 1]
            rows = self._file.rows(name, ptr[0], ptr[-1])
            form = _FORMS[name.partition("_")[0]]
            if (rows.dtype.kind, rows.ndim) != form[:2] or rows.shape[1:][: len(form[2])] != form[2]:
                raise self._damaged(f"{name} holds {rows.dtype} of shape {rows.shape}")
            if (numbered := _numbered(name)) is not None:
                first = self._ptr[numbered][start : stop + 1]  # of the rows that are numbered, each frame's first
                try:
                    rows = _counted_on(rows, ptr - ptr[0], first - first[0], _WIDE.get(name, np.int64))
                except IndexError as error:
                    raise self._damaged(
                        f"{name}, frames {self.frame[start]} to {self.frame[stop - 1]}: {error}"
                    ) from error
            arrays[name] = rows
            if name in _POINTERS or name.startswith("centres_"):
                arrays[_POINTERS.get(name, f"{name}_ptr")] = ptr - ptr[0]
        if "degree" in arrays:
            counts = [int(part.sum()) for part in np.split(arrays["degree"], arrays["ptr"][1:-1])]
            if counts != np.diff(self._ptr["indices"][start : stop + 1]).tolist():
                raise self._damaged("degree does not count the neighbours that indices names")
        return arrays

    def _damaged(self, fault: str) -> InputError:
        return InputError(f"{self.path} is damaged ({fault}). {store.fix_hint(self.path, 'graphs')}")


@contextmanager
def open_graphs(path: str | Path) -> Iterator[Graphs]:
    """Open a graph file, data/graphs/<variant>/<drive>.h5. Raises InputError if it is missing, damaged or another's."""
    with store.DriveReader(Path(path), stage="graphs") as file:
        yield Graphs(file)


def contents(path: Path) -> dict[str, Any]:
    """Return :attr:`Graphs.contents` of a graph file."""
    with open_graphs(path) as graphs:
        return graphs.contents


def described(contents: Mapping[str, Any]) -> str:
    """Say what frames of these :attr:`Graphs.contents` are."""
    if contents["kind"] == "image":
        height, width = contents["image_size"]
        return f"images of {height} x {width} pixels"
    if contents["kind"] == "pointnet2":
        return f"points with PointNet++'s neighbourhoods in {contents['levels']} levels"
    return "kNN graphs"


def concatenate(parts: Sequence[Arrays]) -> Arrays:
    """Put runs of frames of one kind one after the other."""
    if len(parts) == 1:
        return parts[0]
    batch = {}
    for name in parts[0]:
        arrays = [part[name] for part in parts]
        numbered = _numbered(name)
        if numbered is not None:
            before = accumulate((len(part[numbered]) for part in parts), initial=0)
            arrays = [array + first for array, first in zip(arrays, before, strict=False)]  # as wide as they were
        if name.endswith("ptr"):
            arrays = [array[:-1] for array in arrays[:-1]] + arrays[-1:]
        batch[name] = np.concatenate(arrays)
    return batch


def _counted_on(rows: np.ndarray, ptr: np.ndarray, first: np.ndarray, dtype: type[np.integer]) -> np.ndarray:
    """Return the numbers in `rows` plus `first`, that of each frame.

    Both pointers are [B+1]: where each frame's rows begin, and those that its numbers count.

    Raises IndexError if a number is beyond its frame.
    """
    numbers = np.empty(rows.shape, dtype)
    for (start, stop), (shift, end) in zip(pairwise(ptr.tolist()), pairwise(first.tolist()), strict=True):
        largest = int(rows[start:stop].max(initial=0))
        if largest >= end - shift and stop > start:
            raise IndexError(f"there is number {largest} in a frame that has {end - shift}")
        np.add(rows[start:stop], shift, out=numbers[start:stop], dtype=dtype, casting="same_kind")
    return numbers


_FORMS: dict[str, tuple[str, int, tuple[int, ...]]] = {  # kind of numbers, axes, and how long those after the first are
    "xyz": ("f", 2, (3,)), "cls": ("u", 1, ()), "degree": ("u", 1, ()), "indices": ("u", 1, ()),
    "centres": ("u", 1, ()), "neighbours": ("u", 2, ()), "image": ("u", 4, ()),
}  # fmt: skip
_WIDE = {"indices": np.int32}  # as wide as sparse matrices want them; what indexes tensors is int64
_POINTERS = {"xyz": "ptr"}  # the others are called as what they point into


def _numbered(name: str) -> str | None:
    """Return the array whose rows the numbers in array `name` count; None if it holds no such numbers."""
    if name in ("ptr", "indices"):
        return "xyz"
    if name.endswith("_ptr"):
        return name.removesuffix("_ptr")
    what, _, level = name.partition("_")
    if what in ("centres", "neighbours"):
        return "xyz" if level == "1" else f"centres_{int(level) - 1}"
    return None
