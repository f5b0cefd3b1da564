"""Compute the columns of one frame of a graph file: sample a cloud, then connect or group its points."""

import numpy as np

from pipeline.graphs import graph, neighbourhoods
from pipeline.graphs.cloud import Cloud, frame_rng, ordered, sample_points
from pipeline.graphs.graph_file import Column, Columns
from pipeline.settings.graphs import Variant


def build(cloud: Cloud, variant: Variant, drive: str, number: int) -> Columns:
    """Return frame `number` of a variant of points, reproducibly for drive and frame number."""
    assert variant.points
    rng = frame_rng(variant.seed, drive, number)
    sampled = sample_points(cloud, variant.crop_m, variant.points, rng, variant.sampling)
    return connect(ordered(sampled) if variant.accumulate else sampled, variant, rng)


def connect(cloud: Cloud, variant: Variant, rng: np.random.Generator) -> Columns:
    """Return the points with their kNN graph and its numbers of edges, or with PointNet++'s samplings and groupings."""
    assert variant.points
    xyz, cls = cloud
    dtype = graph.index_dtype(variant.points)
    columns = {"xyz": Column(xyz, "m", "ptr"), "cls": Column(cls, "trainId", "ptr")}
    if variant.kind == "graph":
        assert variant.k is not None
        built = graph.build(xyz, cls, variant.k, variant.keep_inter_class, rng)
        columns["degree"] = Column(built.degree, "neighbours", "ptr")
        columns["indices"] = Column(built.indices.astype(dtype), "node", "indices_ptr", "xyz")
        for name, edges in {"edges_knn": built.edges_knn, "edges_kept": built.edges_kept}.items():
            columns[name] = Column(np.array([edges], np.int32), "directed edges")
        return columns
    points = "xyz"  # column whose rows a level samples
    for number, level in enumerate(neighbourhoods.levels(xyz, variant.levels, rng), start=1):
        centres, pointer = f"centres_{number}", f"centres_{number}_ptr"
        columns[centres] = Column(level.centres.astype(dtype), points, pointer, points)
        columns[f"neighbours_{number}"] = Column(level.neighbours.astype(dtype), points, pointer, points)
        points = centres
    return columns


def empty(variant: Variant) -> Columns:
    """Return the columns of a variant of points without rows."""
    columns = connect((np.empty((0, 3), np.float32), np.empty(0, np.uint8)), variant, np.random.default_rng(0))
    return {name: column._replace(rows=column.rows[:0]) for name, column in columns.items()}
