"""The writers of the graph file, all that a network sees of a drive: data/graphs/<variant>/<drive>.h5.

Three kinds: points with their kNN graph, points with PointNet++'s sets, images. Their datasets are in data/README.md;
:mod:`pipeline.train.frames` reads them.
"""

from collections.abc import Iterable, Sequence
from typing import Protocol

import numpy as np

from pipeline.base.store import DriveReader, DriveWriter
from pipeline.graphs import graph, neighbourhoods

Points = tuple[np.ndarray, np.ndarray, np.random.Generator]
"""A frame's xyz float32 [P,3] in metres and cls uint8 [P], and the generator of all that is drawn for it."""
Counts = dict[str, int]
"""What the log says that a file holds."""
MOTION = {"yaw_rate_radps": "rad/s, left positive", "speed_mps": "m/s, forward positive", "valid": ""}


class Neighbours(Protocol):
    """Who neighbours whom in each frame, one kind of file; an object writes one file."""

    def start(self, file: DriveWriter) -> None:
        """Make the datasets."""

    def append(self, file: DriveWriter, xyz: np.ndarray, cls: np.ndarray, rng: np.random.Generator) -> None:
        """Add a frame's."""

    def finish(self, file: DriveWriter) -> Counts:
        """Write where frames begin."""


def write_points(
    file: DriveWriter, frame: np.ndarray, time_s: np.ndarray, clouds: Iterable[Points], neighbours: Neighbours
) -> Counts:
    """Write KITTI frame numbers [F], times [F], and of each frame its points and who neighbours whom."""
    file.put("frame", np.asarray(frame, np.int32))
    file.put("time_s", time_s, unit="s")
    neighbours.start(file)
    file.append("xyz", np.empty((0, 3), np.float32), unit="m")
    file.append("cls", np.empty(0, np.uint8), unit="trainId")
    nodes = []
    for xyz, cls, rng in clouds:
        file.append("xyz", xyz)
        file.append("cls", cls)
        neighbours.append(file, xyz, cls, rng)
        nodes.append(len(xyz))
    file.put_pointers("ptr", nodes, unit="row")
    return {"frames": len(nodes), "points": sum(nodes)} | neighbours.finish(file)


def write_images(
    file: DriveWriter, frame: np.ndarray, time_s: np.ndarray, images: Iterable[np.ndarray], size: tuple[int, int]
) -> Counts:
    """Write KITTI frame numbers [F], times [F], and each frame's image, uint8 RGB [H,W,3] of `size` (H, W)."""
    file.put("frame", np.asarray(frame, np.int32))
    file.put("time_s", time_s, unit="s")
    file.append("image", np.empty((0, *size, 3), np.uint8), unit="RGB")
    for image in images:
        file.append("image", image[None])
    return {"frames": len(frame)}


def put_motion(file: DriveWriter, kind: str, frame: np.ndarray, motion: DriveReader) -> None:
    """Write the motion since the frame before of frame numbers [F]: 0 and not valid where the motion file has none."""
    number = motion.frame
    row = np.searchsorted(number, frame)
    known = np.isin(frame, number)
    for name, unit in MOTION.items():
        values = motion[name]
        picked = np.zeros(len(frame), values.dtype)
        picked[known] = values[row[known]]
        file.put(f"{kind}_{name}", picked, unit)


class KnnGraph:
    """The kNN graph of each frame: degree, indices, and how many edges there were."""

    def __init__(self, points: int, k: int, keep_inter_class: float) -> None:
        """`points`: the most that a frame has; the others as in :func:`pipeline.graphs.graph.build`."""
        self._dtype = graph.index_dtype(points)
        self._k, self._keep_inter_class = k, keep_inter_class
        self._counts: list[tuple[int, int, int]] = []  # entries, kNN edges, kept edges of each frame

    def start(self, file: DriveWriter) -> None:
        file.append("degree", np.empty(0, np.uint8), unit="neighbours")
        file.append("indices", np.empty(0, self._dtype), unit="node")

    def append(self, file: DriveWriter, xyz: np.ndarray, cls: np.ndarray, rng: np.random.Generator) -> None:
        made = graph.build(xyz, cls, self._k, self._keep_inter_class, rng)
        file.append("degree", made.degree)
        file.append("indices", made.indices)
        self._counts.append((len(made.indices), made.edges_knn, made.edges_kept))

    def finish(self, file: DriveWriter) -> Counts:
        entries, edges_knn, edges_kept = np.array(self._counts, np.int64).reshape(-1, 3).T
        file.put_pointers("indices_ptr", entries, unit="row")
        file.put("edges_knn", edges_knn.astype(np.int32), unit="directed edges")
        file.put("edges_kept", edges_kept.astype(np.int32), unit="directed edges")
        return {"kNN edges": int(edges_knn.sum()), "kept": int(edges_kept.sum())}


class PointSets:
    """PointNet++'s samplings and groupings of each frame: centres_1, neighbours_1, centres_2, …"""

    def __init__(self, points: int, sizes: Sequence[neighbourhoods.Size]) -> None:
        """`points`: the most that a frame has; `sizes`: of each level."""
        self._dtype = graph.index_dtype(points)
        self._sizes = sizes
        self._counts: list[list[int]] = [[] for _ in sizes]

    def start(self, file: DriveWriter) -> None:
        for number, (_, _, neighbours) in enumerate(self._sizes, start=1):
            file.append(f"centres_{number}", np.empty(0, self._dtype), unit="point or centre of the level before")
            file.append(f"neighbours_{number}", np.empty((0, neighbours), self._dtype), unit="as the centres")

    def append(self, file: DriveWriter, xyz: np.ndarray, cls: np.ndarray, rng: np.random.Generator) -> None:
        for number, level in enumerate(neighbourhoods.levels(xyz, self._sizes, rng), start=1):
            file.append(f"centres_{number}", level.centres.astype(self._dtype))
            file.append(f"neighbours_{number}", level.neighbours.astype(self._dtype))
            self._counts[number - 1].append(len(level.centres))

    def finish(self, file: DriveWriter) -> Counts:
        for number, counts in enumerate(self._counts, start=1):
            file.put_pointers(f"centres_{number}_ptr", counts, unit="row")
        return {"centres": sum(sum(counts) for counts in self._counts)}
