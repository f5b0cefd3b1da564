"""Build a variant of the networks' input, data/graphs/<variant>/<drive>.h5: sample clouds, connect or group points."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from pipeline.base.runner import Summary
from pipeline.base.store import DriveReader, DriveWriter
from pipeline.graphs import graph, graph_file, neighbourhoods
from pipeline.graphs.accumulate import Accumulator, read_steps
from pipeline.graphs.cloud import Cloud, frame_rng, ordered, sample_points
from pipeline.graphs.graph_file import Column, Columns
from pipeline.settings.graphs import Variant


def graphs_drive(path: Path, source: Path, motion: Path, variant: Variant) -> Summary:
    """Write the frames of a drive as a variant of graphs, and their measured motion.

    Args:
        path: of the new file.
        source: the drive's clouds, or with images its file of stage ingest.
        motion: the drive's file of that stage.
        variant: an entry of section graphs.
    """
    with (
        DriveReader(source, stage=variant.source.split("/")[0]) as input_file,
        DriveReader(motion, stage="motion") as measured,
    ):
        params = measured.params | input_file.params | {"graphs": variant.model_dump(exclude_unset=True)}
        with DriveWriter(path, stage="graphs", drive=input_file.drive, params=params) as file:
            if variant.kind == "image":
                rows = np.flatnonzero(input_file["has_image"])
                frames, empty = (
                    _images(input_file, rows),
                    {"image": Column(input_file.rows("image", 0, 0), "RGB", "ptr")},
                )
            else:
                rows = np.arange(len(input_file.frame))
                frames, empty = _points(input_file, measured, variant), empty_frame(variant)
            frame = input_file.frame[rows]
            counts = graph_file.write(file, frame, input_file.time_s[rows], frames, empty)
            graph_file.put_motion(file, frame, measured)
    return counts


def _images(raw: DriveReader, rows: np.ndarray) -> Iterator[Columns]:
    for row in rows.tolist():
        yield {"image": Column(raw.rows("image", row, row + 1), "RGB", "ptr")}


def _points(clouds: DriveReader, motion: DriveReader, variant: Variant) -> Iterator[Columns]:
    """Yield the graph of each cloud, combined with previous ones if the variant accumulates."""
    accumulator = Accumulator(variant.accumulate.frames) if variant.accumulate else None
    T_before = read_steps(motion, variant.source) if accumulator else {}
    for row, number in enumerate(clouds.frame.tolist()):
        points: Cloud = clouds.rows_of("xyz", row), clouds.rows_of("cls", row)
        if accumulator:
            points = accumulator.add(number, points, T_before.get(number))
        yield build(points, variant, clouds.drive, number)


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
        for name, rows in zip((centres, f"neighbours_{number}"), level, strict=True):
            columns[name] = Column(rows.astype(dtype), points, pointer, points)
        points = centres
    return columns


def empty_frame(variant: Variant) -> Columns:
    """Return the columns of a variant of points without rows."""
    columns = connect((np.empty((0, 3), np.float32), np.empty(0, np.uint8)), variant, np.random.default_rng(0))
    return {name: column._replace(rows=column.rows[:0]) for name, column in columns.items()}
