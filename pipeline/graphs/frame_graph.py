"""Build a variant of the networks' input, data/graphs/<variant>/<drive>.h5: draw points, connect or
group them.
"""

from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

import numpy as np

from pipeline.base.runner import Summary
from pipeline.base.store import DriveReader, DriveWriter
from pipeline.camera.geometry import transform
from pipeline.clouds.cloud import Cloud, draw_points, frame_rng, ordered
from pipeline.graphs import graph, graph_file
from pipeline.graphs.graph_file import Column, Columns
from pipeline.graphs.settings import Variant


def graphs_drive(path: Path, source: Path, motion: Path, variant: Variant) -> Summary:
    """Write the frames of a drive as a variant of graphs, and their measured motion, to a new file.

    `source`: the drive's clouds, or with images its file of stage ingest; `motion`: its file of
    that stage.
    """
    with (
        DriveReader(source, stage=variant.source.split("/")[0]) as content,
        DriveReader(motion, stage="motion") as measured,
    ):
        frames: Iterable[Columns]
        if variant.kind == "image":
            rows = np.flatnonzero(content["has_image"])
            frames = (
                {"image": Column(content.row("image", row)[None], "RGB", "ptr")}
                for row in rows.tolist()
            )
            empty = {"image": Column(content.row("image", slice(0)), "RGB", "ptr")}
        else:
            rows, empty = np.arange(len(content.frame)), empty_frame(variant)
            points = (
                (content.rows_of("xyz", row), content.rows_of("cls", row)) for row in rows.tolist()
            )
            clouds: Iterator[tuple[int, Cloud]] = zip(content.frame.tolist(), points, strict=True)
            if variant.accumulate:
                clouds = accumulated(
                    clouds, read_steps(measured, variant.source), variant.accumulate
                )
            frames = (build(cloud, variant, content.drive, number) for number, cloud in clouds)
        params = (
            measured.params | content.params | {"graphs": variant.model_dump(exclude_unset=True)}
        )
        with DriveWriter(path, stage="graphs", drive=content.drive, params=params) as file:
            counts = graph_file.write(
                file, content.frame[rows], content.time_s[rows], frames, empty
            )
            graph_file.put_motion(file, content.frame[rows], measured)
    return counts


def build(cloud: Cloud, variant: Variant, drive: str, number: int) -> Columns:
    """Return frame `number` of a variant of points, reproducibly for drive and frame number."""
    assert variant.points
    rng = frame_rng(variant.seed, drive, number)
    drawn = draw_points(cloud, variant.crop_m, variant.points, rng, variant.sampling)
    return connect(ordered(drawn) if variant.accumulate else drawn, variant, rng)


def connect(cloud: Cloud, variant: Variant, rng: np.random.Generator) -> Columns:
    """Return the points with their kNN graph and its numbers of edges, or with PointNet++'s centres
    and groups.
    """
    assert variant.points
    xyz, cls = cloud
    dtype = np.uint16 if variant.points <= 65_535 else np.uint32
    columns = {"xyz": Column(xyz, "m", "ptr"), "cls": Column(cls, "trainId", "ptr")}
    if variant.kind == "graph":
        assert variant.k is not None
        edges = graph.undirected(graph.nearest(xyz, variant.k))
        built = graph.prune(edges, cls, variant.keep_inter_class, rng)
        columns["degree"] = Column(built.degree, "neighbours", "ptr")
        columns["indices"] = Column(built.indices.astype(dtype), "node", "indices_ptr", "xyz")
        columns["edges_knn"] = Column(np.array([built.edges_knn], np.int32), "directed edges")
        columns["edges_kept"] = Column(np.array([built.edges_kept], np.int32), "directed edges")
        return columns
    points = "xyz"  # the column of which a level's centres and neighbours are rows
    for number, level in enumerate(graph.levels(xyz, variant.levels, rng), start=1):
        centres, pointer = f"centres_{number}", f"centres_{number}_ptr"
        for name, rows in zip((centres, f"neighbours_{number}"), level, strict=True):
            columns[name] = Column(rows.astype(dtype), points, pointer, points)
        points = centres
    return columns


def empty_frame(variant: Variant) -> Columns:
    """Return the columns of a variant of points without rows."""
    columns = connect(
        (np.empty((0, 3), np.float32), np.empty(0, np.uint8)), variant, np.random.default_rng(0)
    )
    return {name: column._replace(rows=column.rows[:0]) for name, column in columns.items()}


def read_steps(motion: DriveReader, source: str) -> dict[int, np.ndarray]:
    """Return frame number → T_before_now float64 [4,4] of the valid frames of a motion file.

    It has the length unit of the clouds of `source`. Visual odometry multiplies depth by ``scale``;
    clouds/pseudo are lifted from uncorrected depth. So the step's translation is divided by the
    scale, and static objects coincide whatever the scale of depth. clouds/lidar are in metres, as
    motion is.
    """
    valid = motion["valid"].astype(bool)
    steps = motion["T_before_now"][valid].astype(np.float64)
    if source == "clouds/pseudo":
        steps[:, :3, 3] /= motion["scale"][valid, None]
    return dict(zip(motion.frame[valid].tolist(), steps, strict=True))


def accumulated(
    clouds: Iterable[tuple[int, Cloud]], steps: Mapping[int, np.ndarray], frames: int
) -> Iterator[tuple[int, Cloud]]:
    """Combine each cloud with up to `frames` - 1 previous ones, in its coordinates; `steps`: see
    :func:`read_steps`.

    It reaches back as long as frame numbers are consecutive and motion is valid. So it starts anew
    after a halt, since standstill looks like unmeasured motion. Moving objects leave a trace, and
    passed ones lie behind the camera.
    """
    recent: list[tuple[np.ndarray, Cloud]] = []  # T_now_then and the cloud, oldest first
    last = -2
    for number, cloud in clouds:
        if number == last + 1 and number in steps:
            T_now_before = np.linalg.inv(steps[number])
            recent = [
                (T_now_before @ T_before_then, then) for T_before_then, then in recent[1 - frames :]
            ]
        else:
            recent = []
        recent.append((np.eye(4), cloud))
        last = number
        xyz = np.concatenate([transform(T_now_then, then[0]) for T_now_then, then in recent])
        yield number, (xyz.astype(np.float32), np.concatenate([then[1] for _, then in recent]))
