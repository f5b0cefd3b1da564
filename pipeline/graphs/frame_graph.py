"""Build a variant of the networks' input, data/graphs/<variant>/<drive>.h5: sample clouds, connect or group points."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from pipeline.base.runner import Summary
from pipeline.base.store import DriveReader, DriveWriter
from pipeline.camera.geometry import transform
from pipeline.graphs import graph, graph_file, neighbourhoods
from pipeline.graphs.cloud import Cloud, frame_rng, ordered, sample_points
from pipeline.graphs.graph_file import Column, Columns
from pipeline.settings.graphs import Variant


def graphs_drive(path: Path, source: Path, motion: Path, variant: Variant) -> Summary:
    """Write the frames of a drive as a variant of graphs, and their measured motion, to a new file.

    `source`: the drive's clouds, or with images its file of stage ingest; `motion`: its file of that stage.
    """
    with (
        DriveReader(source, stage=variant.source.split("/")[0]) as input_file,
        DriveReader(motion, stage="motion") as measured,
    ):
        params = measured.params | input_file.params | {"graphs": variant.model_dump(exclude_unset=True)}
        with DriveWriter(path, stage="graphs", drive=input_file.drive, params=params) as file:
            if variant.kind == "image":
                rows = np.flatnonzero(input_file["has_image"])
                empty = {"image": Column(input_file.rows("image", 0, 0), "RGB", "ptr")}
                frames = _images(input_file, rows)
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
    dtype = np.uint16 if variant.points <= 65_535 else np.uint32
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


def read_steps(motion: DriveReader, source: str) -> dict[int, np.ndarray]:
    """Return frame number → T_before_now float64 [4,4] of the valid frames of a motion file.

    It has the length unit of the clouds of `source`. Visual odometry multiplies depth by ``scale``; clouds/pseudo are
    lifted from uncorrected depth. So the step's translation is divided by the scale, and static objects coincide
    whatever the scale of depth. clouds/lidar are in metres, as motion is.
    """
    valid = motion["valid"].astype(bool)
    steps = motion["T_before"][valid].astype(np.float64)
    if source == "clouds/pseudo":
        steps[:, :3, 3] /= motion["scale"][valid, None]
    return dict(zip(motion.frame[valid].tolist(), steps, strict=True))


class Accumulator:
    """Combines each cloud with up to `frames` - 1 previous ones.

    It reaches back as long as frame numbers are consecutive and motion is valid. So it starts anew after a halt, since
    standstill looks like unmeasured motion. Moving objects leave a trace, and objects that the car has passed
    lie behind the camera.
    """

    def __init__(self, frames: int) -> None:
        self._frames = frames
        self._clouds: list[tuple[np.ndarray, Cloud]] = []  # T_now_then and the cloud, oldest first
        self._last: int | None = None

    def add(self, number: int, cloud: Cloud, T_before: np.ndarray | None) -> Cloud:
        """Return the combined cloud of the next frame, in its coordinates.

        `T_before`: the step to this frame, see :func:`read_steps`; None if it was not measured.
        """
        if self._last is None or number != self._last + 1 or T_before is None:
            self._clouds = []
        else:
            T_now_before = np.linalg.inv(T_before)
            previous = self._clouds[1 - self._frames :]
            self._clouds = [(T_now_before @ T_before_then, then) for T_before_then, then in previous]
        self._clouds.append((np.eye(4), cloud))
        self._last = number
        return (
            np.concatenate([transform(T_now_then, xyz) for T_now_then, (xyz, _) in self._clouds]).astype(np.float32),
            np.concatenate([cls for _, (_, cls) in self._clouds]),
        )
