"""Make the frames of a variant of the networks' input, and write data/graphs/<variant>/<drive>.h5.

A frame is an image, or points that are drawn from a cloud and then connected.
"""

from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

import numpy as np

from pipeline.base.runner import Summary
from pipeline.base.store import DriveReader, DriveWriter
from pipeline.camera.geometry import transform
from pipeline.clouds.cloud import Cloud, draw_points, frame_rng, in_morton_order
from pipeline.graphs import graph, graph_file
from pipeline.graphs.graph_file import Column, Columns
from pipeline.graphs.settings import Variant


def graphs_drive(path: Path, source: Path, motion: Path, variant: Variant) -> Summary:
    """Write the frames of a drive in a variant, and their measured motion, to a new file.

    `source` is the drive's file of stage clouds, or of stage ingest if the variant has images.
    `motion` is the drive's file of stage motion.
    """
    with (
        DriveReader(source, stage=variant.source.split("/")[0]) as content,
        DriveReader(motion, stage="motion") as measured,
    ):
        if variant.kind == "image":
            rows = np.flatnonzero(content["has_image"])
            frames = _image_frames(content, rows)
            empty = _image_columns(content.row("image", slice(0)))
        else:
            rows = np.arange(len(content.frame))
            frames = _point_frames(content, measured, variant)
            empty = empty_frame(variant)

        settings = {"graphs": variant.model_dump(exclude_unset=True)}
        params = measured.params | content.params | settings
        numbers = content.frame[rows]
        with DriveWriter(path, stage="graphs", drive=content.drive, params=params) as file:
            counts = graph_file.write(file, numbers, content.time_s[rows], frames, empty)
            graph_file.put_motion(file, numbers, measured)
    return counts


def _image_frames(content: DriveReader, rows: np.ndarray) -> Iterator[Columns]:
    for row in rows.tolist():
        yield _image_columns(content.row("image", row)[None])


def _image_columns(images: np.ndarray) -> Columns:
    return {"image": Column(images, "RGB", "ptr")}


def _point_frames(content: DriveReader, motion: DriveReader, variant: Variant) -> Iterator[Columns]:
    clouds = _read_clouds(content)
    if variant.accumulate:
        clouds = accumulate(clouds, read_steps(motion, variant.source), variant.accumulate)
    for number, cloud in clouds:
        yield build_frame(cloud, variant, content.drive, number)


def _read_clouds(content: DriveReader) -> Iterator[tuple[int, Cloud]]:
    for row, number in enumerate(content.frame.tolist()):
        yield number, Cloud(content.rows_of("xyz", row), content.rows_of("cls", row))


def build_frame(cloud: Cloud, variant: Variant, drive: str, number: int) -> Columns:
    """Return frame `number` of a variant of points.

    Random draws depend only on the variant's seed, the drive and the frame number.
    """
    assert variant.points
    rng = frame_rng(variant.seed, drive, number)
    drawn = draw_points(cloud, variant.crop_m, variant.points, rng, variant.sampling)
    if variant.accumulate:
        drawn = in_morton_order(drawn)
    return connect(drawn, variant, rng)


def connect(cloud: Cloud, variant: Variant, rng: np.random.Generator) -> Columns:
    """Return the columns of a frame: its points, and their kNN graph, which may have no edges."""
    assert variant.points
    xyz, cls = cloud
    columns = {"xyz": Column(xyz, "m", "ptr"), "cls": Column(cls, "trainId", "ptr")}
    row_type = np.uint16 if variant.points <= 65_535 else np.uint32

    edges = graph.undirected(graph.nearest_neighbours(xyz, variant.k))
    pruned = graph.prune(edges, cls, variant.keep_inter_class, rng)
    columns["degree"] = Column(pruned.degree, "neighbours", "ptr")
    columns["indices"] = Column(pruned.indices.astype(row_type), "node", "indices_ptr")
    columns["edges_knn"] = Column(np.array([pruned.edges_knn], np.int32), "directed edges")
    columns["edges_kept"] = Column(np.array([pruned.edges_kept], np.int32), "directed edges")
    return columns


def empty_frame(variant: Variant) -> Columns:
    """Return the columns of a frame without points, for a variant of points."""
    cloud = Cloud(np.empty((0, 3), np.float32), np.empty(0, np.uint8))
    columns = connect(cloud, variant, np.random.default_rng(0))
    return {name: column._replace(rows=column.rows[:0]) for name, column in columns.items()}


def read_steps(motion: DriveReader, source: str) -> dict[int, np.ndarray]:
    """Return frame number → T_before_now float64 [4,4] of the valid frames of a motion file.

    Translations have the length unit of the clouds of `source`. Visual odometry corrects depth by
    the factor ``scale``, but clouds/pseudo are made from uncorrected depth. So their translations
    are divided by this factor, which makes static objects coincide whatever the scale of depth is.
    Motion and clouds/lidar are both in metres.
    """
    valid = motion["valid"].astype(bool)
    steps = motion["T_before_now"][valid].astype(np.float64)
    if source == "clouds/pseudo":
        steps[:, :3, 3] /= motion["scale"][valid, None]
    return dict(zip(motion.frame[valid].tolist(), steps, strict=True))


def accumulate(
    clouds: Iterable[tuple[int, Cloud]], steps: Mapping[int, np.ndarray], frames: int
) -> Iterator[tuple[int, Cloud]]:
    """Combine each cloud with up to `frames` - 1 previous clouds, in its own coordinates.

    `clouds` are frame numbers with clouds, and `steps` is frame number → T_before_now. Clouds are
    combined as long as frame numbers are consecutive and motion is valid. So they start anew after
    a halt, since standstill looks like unmeasured motion. Moving objects leave a trace, and objects
    that the car has passed lie behind the camera.
    """
    recent: list[tuple[np.ndarray, Cloud]] = []  # T_now_past and the past cloud, oldest first
    # Frame numbers start at 0, so no first frame follows this one.
    previous = -2
    for number, cloud in clouds:
        # Move the past clouds by the step of the car, or forget them after a gap.
        if number == previous + 1 and number in steps:
            T_now_before = np.linalg.inv(steps[number])
            recent = [
                (T_now_before @ T_before_past, past) for T_before_past, past in recent[1 - frames :]
            ]
        else:
            recent = []
        recent.append((np.eye(4), cloud))
        previous = number

        xyz = np.concatenate([transform(T_now_past, past.xyz) for T_now_past, past in recent])
        cls = np.concatenate([past.cls for _, past in recent])
        yield number, Cloud(xyz.astype(np.float32), cls)
