"""The graph file, the input of the networks for one drive: data/graphs/<variant>/<drive>.h5.

A frame is a dict of columns, whose arrays are by kind of frame

- graph: xyz float32 [P,3] in metres, cls uint8 [P], and the kNN graph: degree uint8 [P], indices
  [ΣP degree];
- pointnet2: xyz, cls, and for each level l from 1 centres_l [M] and neighbours_l [M,n];
- image: image uint8 [1,H,W,3].

A column declares where each frame starts and, if it holds row numbers, what it counts. The file
keeps both.
"""

from collections.abc import Callable, Iterable, Mapping
from functools import cached_property
from itertools import chain, count
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from pipeline.base import store

Arrays = dict[str, np.ndarray]
MOTION = {  # dataset → dataset of the motion file, unit
    "motion_yaw_rate_radps": ("yaw_rate_radps", "rad/s, left positive"),
    "motion_speed_mps": ("filtered_mps", "m/s, forward positive"),
    "motion_valid": ("valid", ""),
}


class Column(NamedTuple):
    """One array of a frame."""

    rows: np.ndarray
    unit: str
    pointer: str = ""  # array with the first row of each frame; "": a row per frame
    # column whose rows these numbers count, from 0 in each frame; "": no row numbers
    refers_to: str = ""


Columns = dict[str, Column]


class Contents(NamedTuple):
    """Kind of the frames, and the sizes that a network takes from them."""

    kind: str  # FrameKind in models/steering/core/batch.py
    levels: int = 0  # of PointNet++
    image_size: tuple[int, int] | None = None  # (H, W)

    def __str__(self) -> str:
        sizes = {
            "pointnet2": f" with {self.levels} levels",
            "image": f" of {self.image_size} (H, W) pixels",
        }
        return f"frames of kind {self.kind}{sizes.get(self.kind, '')}"


class MeasuredMotion(NamedTuple):
    """Motion of the car since the previous frame, left and forward positive; all 0 where it is not
    valid.
    """

    yaw_rate_radps: np.ndarray  # float32 [G]
    speed_mps: np.ndarray  # float32 [G]
    valid: np.ndarray  # uint8 [G]


def write(
    file: store.DriveWriter,
    frame: np.ndarray,
    time_s: np.ndarray,
    frames: Iterable[Columns],
    empty: Columns,
) -> dict[str, int]:
    """Write KITTI frame numbers [F], times [F], and the frames; return the numbers of frames and
    points.

    `empty`: the columns without rows, which create the datasets also in the file of a drive without
    frames.
    """
    file.put("frame", np.asarray(frame, np.int32))
    file.put("time_s", time_s, unit="s")
    lengths: list[dict[str, int]] = []
    for columns in chain([empty], frames):
        for name, column in columns.items():
            file.append(name, *column)
        lengths.append(
            {column.pointer: len(column.rows) for column in columns.values() if column.pointer}
        )
    for pointer in lengths[0]:
        file.put_pointers(
            pointer, [frame_lengths[pointer] for frame_lengths in lengths[1:]], unit="row"
        )
    points = (
        {"points": sum(frame_lengths["ptr"] for frame_lengths in lengths)} if "xyz" in empty else {}
    )
    return {"frames": len(frame), **points}


def put_motion(file: store.DriveWriter, frame: np.ndarray, motion: store.DriveReader) -> None:
    """Write the measured motion of frame numbers [F]; 0 and not valid for frames that the motion
    file lacks.
    """
    _, here, measured = np.intersect1d(frame, motion.frame, return_indices=True)
    for name, (source, unit) in MOTION.items():
        values = motion[source]
        column = np.zeros(len(frame), values.dtype)
        column[here] = values[measured]
        file.put(name, column, unit)


class Graphs(store.DriveReader):
    """An open graph file with G frames. Pointers are read once, and columns after :meth:`keep`."""

    kept: Mapping[str, Any] = {}  # ragged columns in memory

    def keep(self, convert: Callable[[np.ndarray], Any]) -> None:
        """Read the ragged columns, from now on ``convert(column)``, into memory."""
        self.kept = {name: convert(self[name]) for name in self.pointers}

    def row(self, name: str, index: int | slice | tuple[()]) -> Any:
        return self.kept[name][index] if name in self.kept else super().row(name, index)

    @property
    def size(self) -> int:
        """Bytes of the ragged columns in memory."""
        return sum(self.datasets[name].nbytes for name in self.pointers)

    @cached_property
    def contents(self) -> Contents:
        if "image" in self:
            _, height, width, _ = self.datasets["image"].shape
            return Contents(kind="image", image_size=(height, width))
        if "degree" in self:
            return Contents(kind="graph")
        return Contents(
            kind="pointnet2", levels=next(n for n in count() if f"centres_{n + 1}" not in self)
        )

    @cached_property
    def counts(self) -> Arrays:
        """Numbers per frame [G], as far as the file has them: points, edges_knn and edges_kept
        (directed).
        """
        points = {"points": np.diff(self["ptr"])} if "xyz" in self else {}
        return points | {name: self[name] for name in ("edges_knn", "edges_kept") if name in self}

    @cached_property
    def motion(self) -> MeasuredMotion | None:
        """Measured motion of all frames; None if the file has none."""
        return MeasuredMotion(*(self[name] for name in MOTION)) if "motion_valid" in self else None

    @cached_property
    def starts(self) -> Arrays:
        """Pointer → first row of each frame and the end, int64 [G+1]."""
        return {pointer: self[pointer] for pointer in dict.fromkeys(self.pointers.values())}


def open_graphs(path: str | Path) -> Graphs:
    """Open a graph file, a context manager. Raises InputError if it is missing, damaged or of
    another stage.
    """
    return Graphs(Path(path), stage="graphs")


def edge_pairs(degree: np.ndarray, indices: np.ndarray) -> np.ndarray:
    """Return both ends [E,2] of each undirected edge of one frame once, the smaller first."""
    pairs = np.stack([np.repeat(np.arange(len(degree)), degree), indices], axis=1)
    return pairs[pairs[:, 0] < pairs[:, 1]]
