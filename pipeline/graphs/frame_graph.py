"""Compute the arrays of one frame of a graph file: sample a cloud, then connect or group its points."""

import numpy as np

from pipeline.graphs import graph, neighbourhoods
from pipeline.graphs.cloud import Cloud, frame_rng, ordered, sample_points
from pipeline.graphs.graph_file import Arrays
from pipeline.settings.graphs import Variant


def build(cloud: Cloud, variant: Variant, drive: str, number: int) -> Arrays:
    """Return frame `number` of a variant of points, reproducibly for drive and frame number."""
    assert variant.points
    rng = frame_rng(variant.seed, drive, number)
    sampled = sample_points(cloud, variant.crop_m, variant.points, rng, variant.sampling)
    return connect(ordered(sampled) if variant.accumulate else sampled, variant, rng)


def connect(cloud: Cloud, variant: Variant, rng: np.random.Generator) -> Arrays:
    """Return the points with their kNN graph and its numbers of edges, or with PointNet++'s samplings and groupings."""
    assert variant.points
    xyz, cls = cloud
    dtype = graph.index_dtype(variant.points)
    arrays = {"xyz": xyz, "cls": cls}
    if variant.kind == "graph":
        assert variant.k is not None
        built = graph.build(xyz, cls, variant.k, variant.keep_inter_class, rng)
        arrays |= {"degree": built.degree, "indices": built.indices.astype(dtype)}
        return arrays | {"edges_knn": np.array(built.edges_knn), "edges_kept": np.array(built.edges_kept)}
    for number, level in enumerate(neighbourhoods.levels(xyz, variant.levels, rng), start=1):
        arrays[f"centres_{number}"] = level.centres.astype(dtype)
        arrays[f"neighbours_{number}"] = level.neighbours.astype(dtype)
    return arrays


def empty(variant: Variant) -> Arrays:
    """Return a frame without points."""
    return connect((np.empty((0, 3), np.float32), np.empty(0, np.uint8)), variant, np.random.default_rng(0))
