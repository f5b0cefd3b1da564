"""The graph file, the input of the networks for one drive: data/graphs/<variant>/<drive>.h5.

Three kinds of frames: points with a kNN graph, points with PointNet++'s neighbourhoods, images. data/README.md lists
the datasets; :mod:`pipeline.train.frames` reads them.
"""

from collections.abc import Iterable
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


def neighbours(variant: Variant, xyz: np.ndarray, cls: np.ndarray, rng: np.random.Generator) -> Arrays:
    """Return a frame's datasets beside its points; those without axes are numbers per frame.

    degree and indices of the kNN graph, and the numbers of edges before and after pruning; or PointNet++'s samplings
    and groupings: centres_1, neighbours_1, centres_2, …
    """
    assert variant.points
    dtype = graph.index_dtype(variant.points)
    if variant.kind == "graph":
        assert variant.k
        built = graph.build(xyz, cls, variant.k, variant.keep_inter_class, rng)
        edges = {"edges_knn": np.array(built.edges_knn), "edges_kept": np.array(built.edges_kept)}
        return {"degree": built.degree, "indices": built.indices.astype(dtype), **edges}
    arrays: Arrays = {}
    for number, level in enumerate(neighbourhoods.levels(xyz, variant.levels, rng), start=1):
        arrays[f"centres_{number}"] = level.centres.astype(dtype)
        arrays[f"neighbours_{number}"] = level.neighbours.astype(dtype)
    return arrays


def has_pointers(name: str) -> bool:
    """Return whether frames differ in their rows of a dataset: its first row of each frame is in <name>_ptr."""
    return name.startswith(("indices", "centres"))


def sample_frame(cloud: Cloud, variant: Variant, drive: str, number: int) -> Points:
    """Sample the points of a frame for a variant, reproducibly for drive and frame number."""
    assert variant.points
    rng = frame_rng(variant.seed, drive, number)
    sampled = sample_points(cloud, variant.crop_m, variant.points, rng)
    return (*(ordered(sampled) if variant.accumulate else sampled), rng)


def write_points(
    file: DriveWriter, frame: np.ndarray, time_s: np.ndarray, clouds: Iterable[Points], variant: Variant
) -> Counts:
    """Write KITTI frame numbers [F], times [F], and the points and neighbours of each frame."""
    file.put("frame", np.asarray(frame, np.int32))
    file.put("time_s", time_s, unit="s")
    no_points = np.empty((0, 3), np.float32), np.empty(0, np.uint8)
    lengths: dict[str, list[int]] = {"xyz": []}
    numbers: dict[str, list[int]] = {}
    # The empty frame creates the datasets, also in the file of a drive without frames.
    for row, (xyz, cls, rng) in enumerate(chain([(*no_points, np.random.default_rng(0))], clouds)):
        for name, array in {**neighbours(variant, xyz, cls, rng), "xyz": xyz, "cls": cls}.items():
            if array.ndim == 0:
                numbers.setdefault(name, []).extend([int(array)] if row else [])
                continue
            file.append(name, array, UNITS[name.partition("_")[0]])
            if name == "xyz" or has_pointers(name):
                lengths.setdefault(name, []).extend([len(array)] if row else [])
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
