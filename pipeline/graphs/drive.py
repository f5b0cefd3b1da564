"""Build one variant of the networks' input for a drive, data/graphs/<variant>/<drive>.h5."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from pipeline.base.errors import named_frames
from pipeline.base.runner import Summary
from pipeline.base.store import DriveReader, DriveWriter
from pipeline.graphs import frame_graph, graph_file
from pipeline.graphs.accumulate import Accumulator, read_steps
from pipeline.graphs.cloud import Cloud
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
                frames, empty = _points(input_file, measured, variant), frame_graph.empty(variant)
            frame = input_file.frame[rows]
            counts = graph_file.write(file, frame, input_file.time_s[rows], frames, empty)
            graph_file.put_motion(file, frame, measured)
    return counts


def _images(raw: DriveReader, rows: np.ndarray) -> Iterator[Columns]:
    for row, _ in zip(rows.tolist(), named_frames(raw.frame[rows]), strict=True):
        yield {"image": Column(raw.rows("image", row, row + 1), "RGB", "ptr")}


def _points(clouds: DriveReader, motion: DriveReader, variant: Variant) -> Iterator[Columns]:
    """Yield the graph of each cloud, combined with previous ones if the variant accumulates."""
    accumulator = Accumulator(variant.accumulate.frames) if variant.accumulate else None
    T_before = read_steps(motion, variant.source) if accumulator else {}
    for row, number in enumerate(named_frames(clouds.frame.tolist())):
        points: Cloud = clouds.rows_of("xyz", row), clouds.rows_of("cls", row)
        if accumulator:
            points = accumulator.add(number, points, T_before.get(number))
        yield frame_graph.build(points, variant, clouds.drive, number)
