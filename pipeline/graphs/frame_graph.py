"""Make the frames of a variant of the networks' input, and write data/graphs/<variant>/<drive>.h5.

A frame is an image, or points that are drawn from a cloud and then connected.
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from pipeline.base.store import Column, DriveReader
from pipeline.base.summary import Summary
from pipeline.clouds.cloud import Cloud, frame_rng
from pipeline.clouds.cloud_file import open_clouds
from pipeline.clouds.columns import POINTER
from pipeline.graphs import graph, graph_file
from pipeline.graphs.graph_file import UNITS, Columns
from pipeline.graphs.settings import Variant
from pipeline.ingest.ingest_file import open_ingest


def graphs_drive(path: Path, source: Path, variant: Variant) -> Summary:
    """Write the frames of a drive in a variant to a new file.

    `source` is the drive's file of stage clouds, or of stage ingest if the variant has images.
    """
    open_source = open_ingest if variant.kind == "image" else open_clouds
    with open_source(source) as content:
        if variant.kind == "image":
            rows = np.flatnonzero(content["has_image"])
            frames = _image_frames(content, rows)
            empty = _image_columns(content.row("image", slice(0)))
        else:
            rows = np.arange(len(content.frame))
            frames = _point_frames(content, variant)
            empty = empty_frame(Cloud.read(content, variant.columns, slice(0)), variant)

        params = content.params | {"graphs": variant.model_dump(exclude_unset=True)}
        numbers = content.frame[rows]
        with graph_file.create_graphs(path, drive=content.drive, params=params) as file:
            counts = graph_file.write_frames(file, numbers, content.time_s[rows], frames, empty)
    return counts


def _image_frames(content: DriveReader, rows: np.ndarray) -> Iterator[Columns]:
    for row in rows.tolist():
        yield _image_columns(content.row("image", row)[None])


def _image_columns(images: np.ndarray) -> Columns:
    return {"image": Column(images, UNITS["image"], POINTER)}


def _point_frames(content: DriveReader, variant: Variant) -> Iterator[Columns]:
    starts = content[POINTER].tolist()
    for row, number in enumerate(content.frame.tolist()):
        cloud = Cloud.read(content, variant.columns, slice(starts[row], starts[row + 1]))
        yield build_frame(cloud, variant, content.drive, number)


def build_frame(cloud: Cloud, variant: Variant, drive: str, number: int) -> Columns:
    """Return frame `number` of a variant of points.

    Random draws depend only on the variant's seed, the drive and the frame number.
    """
    assert variant.points
    rng = frame_rng(variant.seed, drive, number)
    drawn = cloud.crop(variant.crop_m).draw(variant.points, rng)
    return connect_points(drawn, variant, rng)


def connect_points(cloud: Cloud, variant: Variant, rng: np.random.Generator) -> Columns:
    """Return the columns of a frame: its points, and their kNN graph, which may have no edges."""
    assert variant.points
    columns = dict(cloud.columns)
    row_type = np.uint16 if variant.points <= 65_535 else np.uint32

    edges = graph.undirected(graph.nearest_neighbours(cloud.xyz, variant.k))
    pruned = graph.prune(edges, cloud.cls, variant.keep_inter_class, rng)
    columns["degree"] = Column(pruned.degree, UNITS["degree"], POINTER)
    indices = pruned.indices.astype(row_type)
    columns["indices"] = Column(indices, UNITS["indices"], "indices_ptr")
    edges_knn = np.array([pruned.edges_knn], np.int32)
    columns["edges_knn"] = Column(edges_knn, UNITS["edges_knn"])
    edges_kept = np.array([pruned.edges_kept], np.int32)
    columns["edges_kept"] = Column(edges_kept, UNITS["edges_kept"])
    return columns


def empty_frame(cloud: Cloud, variant: Variant) -> Columns:
    """Return the columns of a frame without points in a variant. `cloud` has none, too."""
    columns = connect_points(cloud, variant, np.random.default_rng(0))
    return {name: column._replace(rows=column.rows[:0]) for name, column in columns.items()}
