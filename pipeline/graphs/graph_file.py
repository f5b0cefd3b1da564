"""Write and read the graph file of a drive, data/graphs/<variant>/<drive>.h5.

The file is the input of the networks. A frame is a dict of columns, which depend on its kind:

- A frame of kind graph has the points xyz, float32 [P,3] in metres, their classes cls, uint8 [P],
  and a kNN graph: the number of neighbours of each point, degree, uint8 [P], and the rows of these
  neighbours, indices [sum(degree)].
- A frame of kind image has the column image, uint8 [1,H,W,3].

A frame of points also has the further columns of the variant, see pipeline/clouds/columns.py.
A column names the array in which the file keeps the first row of each frame. The row numbers in
indices count within a frame.
"""

from collections.abc import Callable, Iterable, Mapping
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from pipeline.base import store
from pipeline.base.store import MEANING, Column
from pipeline.camera import classes

STAGE = "graphs"
# Versions of the layout that are read. The last one is written. Graphs of version 8 also have the
# measured motion, which is read from files of stage motion now.
VERSIONS = [8, 9]
# Dataset → its unit. The docstring says which datasets a kind of frames has.
UNITS = {
    "frame": "",
    "time_s": "s",
    "xyz": "m",
    "cls": "trainId",
    "degree": "neighbours",
    "indices": "node",
    "edges_knn": "directed edges",
    "edges_kept": "directed edges",
    "image": "RGB",
    "ptr": "row",
    "indices_ptr": "row",
}
# Dataset → its attributes beside the unit. Further columns bring their own from clouds.
DESCRIBED: dict[str, dict[str, Any]] = {
    "frame": {MEANING: "KITTI's frame number"},
    "time_s": {MEANING: "time since the first frame of the drive"},
    "xyz": {
        MEANING: "camera coordinates (x right, y down, z forward) of the points that were drawn at "
        "random from the cloud, within crop_m if that is set"
    },
    "cls": {MEANING: "class, or void (255), as in clouds", **classes.ATTRIBUTES},
    "degree": {MEANING: "neighbours of a point after pruning, without itself; all 0 without k"},
    "indices": {
        MEANING: "neighbours, numbered within the frame, point after point: a symmetric CSR matrix"
    },
    "edges_knn": {MEANING: "kNN edges before pruning, k per point"},
    "edges_kept": {
        MEANING: "kNN edges after pruning. indices has more entries: two for each connected pair, "
        "also if only one of them is a nearest neighbour of the other"
    },
    "image": {
        MEANING: "images of the frames that have one, with source: ingest. Such a file has no "
        "points"
    },
    "ptr": {MEANING: "first point or image of each frame"},
    "indices_ptr": {MEANING: "first neighbour of each frame"},
}

Arrays = dict[str, np.ndarray]
Columns = dict[str, Column]


class Contents(NamedTuple):
    """The kind of the frames, and the sizes on which the layers of a network depend."""

    kind: str  # a FrameKind of models/steering/core/batch.py
    image_size: tuple[int, int] | None = None  # (H, W)

    def __str__(self) -> str:
        text = f"frames of kind {self.kind}"
        if self.kind == "image":
            text += f" of {self.image_size} (H, W) pixels"
        return text


def write_frames(
    file: store.DriveWriter,
    frame: np.ndarray,
    time_s: np.ndarray,
    frames: Iterable[Columns],
    empty: Columns,
) -> dict[str, int | str]:
    """Write KITTI frame numbers [F], times [F] and the frames, and return the summary.

    It has counts, and the text ``edges`` with the share of the kNN edges that pruning kept, which
    is empty without edges. `empty` is a frame without rows. It creates the datasets, also in the
    file of a drive without frames.
    """
    file.put("frame", np.asarray(frame, np.int32))
    file.put("time_s", time_s, UNITS["time_s"])
    for name, column in empty.items():
        file.append(name, *column)
    counts: dict[str, list[int]] = {
        column.pointer: [] for column in empty.values() if column.pointer
    }
    edges_knn = 0
    edges_kept = 0
    for columns in frames:
        for name, column in columns.items():
            file.append(name, *column)
        if "edges_knn" in columns:
            edges_knn += int(columns["edges_knn"].rows.sum())
            edges_kept += int(columns["edges_kept"].rows.sum())
        # Columns with the same pointer have equally many rows.
        rows = {column.pointer: len(column.rows) for column in columns.values()}
        for pointer in counts:
            counts[pointer].append(rows[pointer])
    for pointer, counts_of_frames in counts.items():
        file.put_pointers(pointer, counts_of_frames, UNITS[pointer])

    summary: dict[str, int | str] = {"frames": len(frame), "edges": ""}
    if "xyz" in empty:
        summary["points"] = sum(counts["ptr"])
    if edges_knn:
        summary["edges"] = f", {edges_kept / edges_knn:.0%} of the edges kept"
    return summary


class Graphs(store.DriveReader):
    """An open graph file with G frames.

    Pointers are read once. Columns are read for each access, or once after :meth:`keep_columns`.
    Ragged columns are those whose number of rows varies by frame, and so have a pointer.
    """

    kept: Mapping[str, Any] = {}  # ragged columns in memory

    def keep_columns(self, convert: Callable[[np.ndarray], Any]) -> None:
        """Read the ragged columns into memory, where they are kept as ``convert(column)``."""
        self.kept = {name: convert(self[name]) for name in self.pointers}

    def row(self, name: str, index: int | slice | tuple[()]) -> Any:
        if name in self.kept:
            return self.kept[name][index]
        return super().row(name, index)

    @property
    def size(self) -> int:
        """Return the bytes of the ragged columns in memory."""
        return sum(self.datasets[name].nbytes for name in self.pointers)

    @cached_property
    def contents(self) -> Contents:
        if "image" in self:
            _, height, width, _ = self.datasets["image"].shape
            return Contents(kind="image", image_size=(height, width))
        return Contents(kind="graph")

    @cached_property
    def counts(self) -> Arrays:
        """Return the numbers per frame [G] of points and of directed edges, if the file has them.

        edges_knn is counted before and edges_kept after pruning.
        """
        counts = {}
        if "xyz" in self:
            counts["points"] = np.diff(self["ptr"])
        for name in ("edges_knn", "edges_kept"):
            if name in self:
                counts[name] = self[name]
        return counts

    @cached_property
    def starts(self) -> Arrays:
        """Return pointer → first row of each frame, and the end of the last one, int64 [G+1]."""
        return {pointer: self[pointer] for pointer in dict.fromkeys(self.pointers.values())}


def create_graphs(path: Path, *, drive: str, params: Mapping[str, Any]) -> store.DriveWriter:
    """Return the writer of a graph file."""
    return store.DriveWriter(
        path, stage=STAGE, version=VERSIONS[-1], drive=drive, params=params, described=DESCRIBED
    )


def open_graphs(path: str | Path) -> Graphs:
    """Open a graph file, which is a context manager.

    Raises InputError if the file is missing, damaged or of another stage.
    """
    return Graphs(Path(path), {STAGE: VERSIONS})


def edge_pairs(degree: np.ndarray, indices: np.ndarray) -> np.ndarray:
    """Return the two ends [E,2] of each undirected edge of a frame, the smaller row first."""
    rows = np.repeat(np.arange(len(degree)), degree)
    pairs = np.stack([rows, indices], axis=1)
    return pairs[rows < indices]
