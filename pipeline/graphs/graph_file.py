"""The graph file, the input of the networks for one drive: data/graphs/<variant>/<drive>.h5.

Three kinds of frames: points with a kNN graph, points with PointNet++'s neighbourhoods, images. data/README.md lists
the datasets; :mod:`pipeline.train.frames` reads them.
"""

from collections.abc import Iterable, Sequence
from itertools import chain

import numpy as np

from pipeline.base.store import DriveReader, DriveWriter
from pipeline.graphs import graph, neighbourhoods
from pipeline.graphs.cloud import Cloud, frame_rng, ordered, sample_points
from pipeline.sections.graphs import Variant

Points = tuple[np.ndarray, np.ndarray, np.random.Generator]
"""xyz float32 [P,3] in metres, cls uint8 [P], the frame's random generator."""
Arrays = dict[str, np.ndarray]
Counts = dict[str, int]
UNITS = {
    "xyz": "m",
    "cls": "trainId",
    "degree": "neighbours",
    "indices": "node",
    "centres": "point or centre of the level before",
    "neighbours": "as the centres",
}
MOTION = {"yaw_rate_radps": "rad/s, left positive", "speed_mps": "m/s, forward positive", "valid": ""}


class KnnGraph:
    """Computes the kNN graph of a frame: degree, indices, and the numbers of edges before and after pruning."""

    pointers = ("indices",)

    def __init__(self, points: int, k: int, keep_inter_class: float) -> None:
        """`points`: the largest number per frame; the others as in :func:`pipeline.graphs.graph.build`."""
        self._dtype = graph.index_dtype(points)
        self._k, self._keep_inter_class = k, keep_inter_class

    def compute(self, xyz: np.ndarray, cls: np.ndarray, rng: np.random.Generator) -> Arrays:
        """Return the frame's datasets; those without axes are numbers per frame."""
        built = graph.build(xyz, cls, self._k, self._keep_inter_class, rng)
        edges = {"edges_knn": np.array(built.edges_knn), "edges_kept": np.array(built.edges_kept)}
        return {"degree": built.degree, "indices": built.indices.astype(self._dtype), **edges}


class PointSets:
    """Computes PointNet++'s samplings and groupings of a frame: centres_1, neighbours_1, centres_2, …"""

    def __init__(self, points: int, sizes: Sequence[neighbourhoods.Size]) -> None:
        """`points`: the largest number per frame; `sizes`: of each level."""
        self._dtype, self._sizes = graph.index_dtype(points), sizes
        self.pointers = tuple(f"centres_{number}" for number in range(1, len(sizes) + 1))

    def compute(self, xyz: np.ndarray, cls: np.ndarray, rng: np.random.Generator) -> Arrays:
        """Return the frame's datasets."""
        arrays: Arrays = {}
        for number, level in enumerate(neighbourhoods.levels(xyz, self._sizes, rng), start=1):
            arrays[f"centres_{number}"] = level.centres.astype(self._dtype)
            arrays[f"neighbours_{number}"] = level.neighbours.astype(self._dtype)
        return arrays


Neighbours = KnnGraph | PointSets


def neighbours_of(variant: Variant) -> Neighbours:
    """Return what computes the neighbours for a variant of points."""
    assert variant.points
    if variant.kind == "graph":
        assert variant.k
        return KnnGraph(variant.points, variant.k, variant.keep_inter_class)
    return PointSets(variant.points, variant.levels)


def sample_frame(cloud: Cloud, variant: Variant, drive: str, number: int) -> Points:
    """Sample the points of a frame for a variant, reproducibly for drive and frame number."""
    assert variant.points
    rng = frame_rng(variant.seed, drive, number)
    sampled = sample_points(cloud, variant.crop_m, variant.points, rng)
    return (*(ordered(sampled) if variant.accumulate else sampled), rng)


def write_points(
    file: DriveWriter, frame: np.ndarray, time_s: np.ndarray, clouds: Iterable[Points], neighbours: Neighbours
) -> Counts:
    """Write KITTI frame numbers [F], times [F], and the points and neighbours of each frame."""
    file.put("frame", np.asarray(frame, np.int32))
    file.put("time_s", time_s, unit="s")
    no_points = np.empty((0, 3), np.float32), np.empty(0, np.uint8)
    lengths: dict[str, list[int]] = {name: [] for name in ("xyz", *neighbours.pointers)}
    numbers: dict[str, list[int]] = {}
    # The empty frame creates the datasets, also in the file of a drive without frames.
    for row, (xyz, cls, rng) in enumerate(chain([(*no_points, np.random.default_rng(0))], clouds)):
        for name, array in {**neighbours.compute(xyz, cls, rng), "xyz": xyz, "cls": cls}.items():
            if array.ndim == 0:
                numbers.setdefault(name, []).extend([int(array)] if row else [])
                continue
            file.append(name, array, UNITS[name.partition("_")[0]])
            if row and name in lengths:
                lengths[name].append(len(array))
    for name, counts in lengths.items():
        file.put_pointers("ptr" if name == "xyz" else f"{name}_ptr", counts, unit="row")
    for name, values in numbers.items():
        file.put(name, np.array(values, np.int32), unit="directed edges")
    summary = {"frames": len(lengths["xyz"]), "points": sum(lengths["xyz"])}
    return summary | {name: sum(values) for name, values in numbers.items()}


def write_images(
    file: DriveWriter, frame: np.ndarray, time_s: np.ndarray, images: Iterable[np.ndarray], size: tuple[int, int]
) -> Counts:
    """Write KITTI frame numbers [F], times [F], and the image of each frame, uint8 RGB [H,W,3] of `size` (H, W)."""
    file.put("frame", np.asarray(frame, np.int32))
    file.put("time_s", time_s, unit="s")
    file.append("image", np.empty((0, *size, 3), np.uint8), unit="RGB")
    for image in images:
        file.append("image", image[None])
    return {"frames": len(frame)}


def put_motion(file: DriveWriter, kind: str, frame: np.ndarray, motion: DriveReader) -> None:
    """Write the measured motion of frame numbers [F]; 0 and not valid for frames that the motion file lacks."""
    row = np.searchsorted(motion.frame, frame)
    found = np.isin(frame, motion.frame)
    for name, unit in MOTION.items():
        values = motion[name]
        column = np.zeros(len(frame), values.dtype)
        column[found] = values[row[found]]
        file.put(f"{kind}_{name}", column, unit)
