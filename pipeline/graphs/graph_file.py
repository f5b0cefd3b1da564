"""The graph file, the input of the networks for one drive: data/graphs/<variant>/<drive>.h5.

This module alone knows its datasets: it writes them, reads them, and makes batches. A frame is a dict of arrays:

- kind graph: xyz float32 [P,3] in metres, cls uint8 [P], and the kNN graph: degree uint8 [P], indices [ΣP degree];
- kind pointnet2: xyz, cls, and for each level l from 1 centres_l [M] and neighbours_l [M,n];
- kind image: image uint8 [1,H,W,3].

In frames and files, numbers of points count from 0 in each frame. A batch has the same arrays for B frames, one after
the other, with numbers that count from 0 in the batch (indices int32, centres_l and neighbours_l int64), and the first
row of each frame, int64 [B+1], in ptr and centres_l_ptr.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cached_property
from itertools import accumulate, chain, count, pairwise
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from pipeline.base import store
from pipeline.base.errors import InputError
from pipeline.base.params import FrameKind

Arrays = dict[str, np.ndarray]
Counts = dict[str, int]
UNITS = {
    "xyz": "m",
    "cls": "trainId",
    "degree": "neighbours",
    "indices": "node",
    "centres": "point or centre of the level before",
    "neighbours": "as the centres",
    "image": "RGB",
}
MOTION = {"yaw_rate_radps": "rad/s, left positive", "speed_mps": "m/s, forward positive", "valid": ""}
_POINTERS = {"xyz": "ptr", "cls": "ptr", "degree": "ptr", "indices": "indices_ptr"}
Side = Annotated[int, Field(ge=1, le=4096)]


class Contents(BaseModel):
    """Kind of the frames, and the sizes that a network takes from them."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    kind: FrameKind
    levels: Annotated[int, Field(ge=0, le=8)] = 0
    image_size: tuple[Side, Side] | None = None

    def __str__(self) -> str:
        """Return the contents in words."""
        if self.kind == "image":
            return "images of {} x {} pixels".format(*self.image_size or ("?", "?"))
        if self.kind == "pointnet2":
            return f"points with PointNet++ neighbourhoods in {self.levels} levels"
        return "kNN graphs"


class MeasuredMotion(NamedTuple):
    """Motion of the car since the previous frame, left and forward positive; all 0 where it is not valid."""

    yaw_rate_radps: np.ndarray  # float32 [G]
    speed_mps: np.ndarray  # float32 [G]
    valid: np.ndarray  # uint8 [G]


class PointGraph(NamedTuple):
    """The kNN graph of one frame: xyz float32 [P,3], cls uint8 [P], :func:`edge_pairs` int64 [E,2]."""

    xyz: np.ndarray
    cls: np.ndarray
    edges: np.ndarray


def write(
    file: store.DriveWriter, frame: np.ndarray, time_s: np.ndarray, frames: Iterable[Arrays], empty: Arrays
) -> Counts:
    """Write KITTI frame numbers [F], times [F], and the frames; return the numbers of frames, points and edges.

    Arrays of a frame without axes are numbers of edges. `empty` is a frame without rows: it creates the datasets,
    also in the file of a drive without frames.
    """
    file.put("frame", np.asarray(frame, np.int32))
    file.put("time_s", time_s, unit="s")
    lengths: dict[str, list[int]] = {}
    edges: dict[str, list[int]] = {}
    for number, arrays in enumerate(chain([empty], frames)):
        for name, array in arrays.items():
            if array.ndim == 0:
                edges.setdefault(name, []).append(int(array))
                continue
            pointer = _pointer(name)
            file.append(name, array, UNITS[name.partition("_")[0]], pointer)
            if pointer and len(lengths.setdefault(pointer, [])) == number:
                lengths[pointer].append(len(array))
    for name, rows in lengths.items():
        file.put_pointers(name, rows[1:], unit="row")
    for name, values in edges.items():
        file.put(name, np.array(values[1:], np.int32), unit="directed edges")
    points = {"points": sum(lengths["ptr"])} if lengths else {}
    return {"frames": len(frame), **points, **{name: sum(values) for name, values in edges.items()}}


def put_motion(file: store.DriveWriter, kind: str, frame: np.ndarray, motion: store.DriveReader) -> None:
    """Write the measured motion of frame numbers [F]; 0 and not valid for frames that the motion file lacks."""
    row = np.searchsorted(motion.frame, frame)
    measured = np.isin(frame, motion.frame)
    for name, unit in MOTION.items():
        values = motion[name]
        column = np.zeros(len(frame), values.dtype)
        column[measured] = values[row[measured]]
        file.put(f"{kind}_{name}", column, unit)


class Graphs:
    """An open graph file with G frames. Pointers are read once."""

    def __init__(self, file: store.DriveReader) -> None:
        self._file = file
        self.path, self.params = file.path, file.params
        self.frame = file.frame  # int32 [G], KITTI frame numbers, ascending
        self.time_s = file.time_s  # float64 [G]

    @cached_property
    def contents(self) -> Contents:
        """Kind and sizes of the frames."""
        if "image" in self._file:
            _, height, width, _ = self._file.shape("image")
            return Contents(kind="image", image_size=(height, width))
        if "degree" in self._file:
            return Contents(kind="graph")
        return Contents(kind="pointnet2", levels=next(n for n in count() if f"centres_{n + 1}" not in self._file))

    @cached_property
    def counts(self) -> Arrays:
        """Numbers per frame [G]: points, and directed kNN edges before and after pruning, as far as the file has them.

        Names: points, edges_knn, edges_kept.
        """
        points = {"points": np.diff(self._file["ptr"])} if "ptr" in self._file else {}
        return points | {name: self._file[name] for name in ("edges_knn", "edges_kept") if name in self._file}

    @property
    def points_per_frame(self) -> float:
        """Mean number of points; 0 for images and for a file without frames."""
        return float(self.counts["points"].mean()) if "points" in self.counts and len(self.frame) else 0.0

    @property
    def empty(self) -> bool:
        """Whether the file has no point or image."""
        return not self.counts.get("points", self.frame + 1).any()

    @cached_property
    def motions(self) -> tuple[str, ...]:
        """Kinds of measured motion in the file: visual, lidar."""
        return tuple(kind for kind in ("visual", "lidar") if f"{kind}_valid" in self._file)

    def motion(self, kind: str) -> MeasuredMotion:
        """Return the motion of this kind for all frames. Raises InputError if the file has none."""
        if kind not in self.motions:
            stored = ", ".join(self.motions) or "none"
            fix = f"Add {kind} to motion.kinds in the params file and run dvc repro"
            raise InputError(f"no motion of kind {kind} (found: {stored})", self.path, fix)
        return MeasuredMotion(*(self._file[f"{kind}_{name}"] for name in MOTION))

    @cached_property
    def _starts(self) -> Arrays:
        """Array → int64 [G+1], first row of each frame."""
        if self.contents.kind == "image":
            return {"image": np.arange(len(self.frame) + 1)}
        names = ["degree", "indices"] if self.contents.kind == "graph" else []
        for level in range(1, self.contents.levels + 1):
            names += [f"centres_{level}", f"neighbours_{level}"]
        pointers = {name: self._file[name] for name in {_pointer(name) for name in ("xyz", *names)}}
        return {name: pointers[_pointer(name)] for name in ("xyz", "cls", *names)}

    def row_of(self, number: int) -> int:
        """Return the row of a KITTI frame number. Raises InputError if the file has no such frame."""
        return self._file.row_of(number)

    def read(self, start: int, stop: int) -> Arrays:
        """Return frames [start, stop) as a batch. Raises InputError if a graph in the file is inconsistent."""
        starts = {name: starts[start : stop + 1] for name, starts in self._starts.items()}
        rows = {name: self._file.rows(name, ptr[0], ptr[-1]) for name, ptr in starts.items()}
        try:
            return _batch(rows, {name: ptr - ptr[0] for name, ptr in starts.items()})
        except ValueError as error:
            fix = store.fix_hint(self.path, "graphs")
            raise InputError(f"the file is damaged ({error})", self.path, fix) from error

    def graph(self, row: int) -> PointGraph:
        """Return the graph of the frame at `row`. Raises InputError if the file has no kNN graphs."""
        if self.contents.kind != "graph":
            raise InputError(f"expected kNN graphs, got {self.contents}", self.path)
        arrays = self.read(row, row + 1)
        return PointGraph(arrays["xyz"], arrays["cls"], edge_pairs(arrays["degree"], arrays["indices"]))


@contextmanager
def open_graphs(path: str | Path) -> Iterator[Graphs]:
    """Open a graph file. Raises InputError if it is missing, damaged or written by another stage."""
    with store.DriveReader(Path(path), stage="graphs") as file:
        yield Graphs(file)


def edge_pairs(degree: np.ndarray, indices: np.ndarray) -> np.ndarray:
    """Return both ends [E,2] of each undirected edge of one frame once, the smaller first."""
    pairs = np.stack([np.repeat(np.arange(len(degree)), degree), indices], axis=1)
    return pairs[pairs[:, 0] < pairs[:, 1]]


def single(frame: Arrays) -> Arrays:
    """Return a frame as a batch, as :meth:`Graphs.read` does for a written frame."""
    rows = {name: array for name, array in frame.items() if array.ndim}
    return _batch(rows, {name: np.array([0, len(array)]) for name, array in rows.items()})


def concatenate(batches: Sequence[Arrays]) -> Arrays:
    """Concatenate batches of one kind."""
    if len(batches) == 1:
        return batches[0]
    result = {}
    for name in batches[0]:
        arrays = [batch[name] for batch in batches]
        if target := _target(name):
            before = accumulate((len(batch[target]) for batch in batches), initial=0)
            arrays = [array + first for array, first in zip(arrays, before, strict=False)]  # keeps the dtype
        if name.endswith("ptr"):
            arrays = [array[:-1] for array in arrays[:-1]] + arrays[-1:]
        result[name] = np.concatenate(arrays)
    return result


def _batch(rows: Arrays, starts: Mapping[str, np.ndarray]) -> Arrays:
    """Return the batch of frames whose arrays are `rows`; `starts`: array → first row of each frame, from 0.

    Raises ValueError if a number exceeds its frame, or the degrees do not fit the indices.
    """
    batch: dict[str, Any] = {}
    for name, array in rows.items():
        target = _target(name)
        batch[name] = _renumber(name, array, starts[name], starts[target]) if target else array
        if pointer := _pointer(name):
            batch[pointer] = starts[name]
    if "degree" in batch:
        edges = np.concatenate([[0], np.cumsum(batch["degree"], dtype=np.int64)])
        if not np.array_equal(edges[batch["ptr"]], batch.pop("indices_ptr")):
            raise ValueError("the sum of degree is not the number of indices")
    return batch


def _renumber(name: str, rows: np.ndarray, starts: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Return `rows` with numbers that count from 0 in the batch.

    Args:
        starts: [B+1], each frame's first row in `rows`.
        target: [B+1], each frame's first row in the array that the numbers refer to.
    """
    dtype = np.int32 if name == "indices" else np.int64  # for sparse matrices; for indexing
    numbers = np.empty(rows.shape, dtype)
    for (start, stop), (first, end) in zip(pairwise(starts.tolist()), pairwise(target.tolist()), strict=True):
        if stop > start and rows[start:stop].max(initial=0) >= end - first:
            raise ValueError(f"{name} exceeds the {end - first} rows of a frame")
        np.add(rows[start:stop], first, out=numbers[start:stop], dtype=dtype, casting="same_kind")
    return numbers


def _pointer(name: str) -> str:
    """Return the dataset with the first row of each frame in array `name`; "" if it has one row per frame."""
    array, _, level = name.partition("_")
    return f"centres_{level}_ptr" if array in ("centres", "neighbours") else _POINTERS.get(name, "")


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
