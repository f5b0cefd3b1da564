"""Measure a row of the table, and provide graphs: of recorded scans, or of the sample."""

import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from models.steering.core.batch import GraphBatch, from_arrays
from pipeline.base import store
from pipeline.base.errors import InputError
from pipeline.graphs import cloud, frame_graph, graph_file
from pipeline.settings.graphs import Variant

ROUNDS = 5
DEVICE = "cuda" if torch.cuda.is_available() else "cpu"
Measurement = Callable[[], float]
"""Do the work once and return the result in the unit of the row."""
FRAMES = 31  # a span of 24 windows of 8 frames
POINTS, K, KEEP_INTER_CLASS = 43_000, 6, 0.2  # paper, Table 1
ROAD, STANDING = 0, (2, 8, 13, 5)  # trainIds: road; building, vegetation, car, pole


@dataclass(frozen=True)
class Row:
    """Medians in `unit`; `ratio` above 1: this project is better by that factor."""

    ours: float
    alternative: float
    unit: str
    ratio: float
    what: str


def compare(ours: Measurement, alternative: Measurement, unit: str, what: str) -> Row:
    """Run both once to warm up, then in turn, so that other load on the machine affects both; medians count."""
    ours(), alternative()
    results = [(ours(), alternative()) for _ in range(ROUNDS)]
    first, second = (statistics.median(column) for column in zip(*results, strict=True))
    return row(first, second, unit, what)


def row(ours: float, alternative: float, unit: str, what: str) -> Row:
    """Return the row of two results."""
    return Row(ours, alternative, unit, ours / alternative if unit.endswith("/s") else alternative / ours, what)


def milliseconds(work: Callable[[], object], items: int = 1) -> Measurement:
    """Return a measurement of `work` in milliseconds per item, if one call processes `items`."""

    def measure() -> float:
        start = time.perf_counter()
        work()
        if DEVICE == "cuda":
            torch.cuda.synchronize()
        return 1e3 * (time.perf_counter() - start) / items

    return measure


@dataclass(frozen=True)
class Street:
    """A graph file of at least FRAMES frames."""

    file: Path

    @property
    def title(self) -> str:
        """The number of points per frame, for the table."""
        with graph_file.open_graphs(self.file) as file:
            return f"{round(file.points_per_frame):,} points"

    def batch(self, count: int, device: str = DEVICE) -> GraphBatch:
        """Return the first `count` frames as a batch of the graph network."""
        with graph_file.open_graphs(self.file) as file:
            batch = from_arrays(graph_file.collate([(file, 0, count)]), device)
        assert isinstance(batch, GraphBatch)
        return batch


def sample(data: Path) -> Street:
    """Return the first training drive of the sample. Raises InputError if ``make demo`` has not written it."""
    folder = data / "graphs/semantic"
    if not (folder / "index.json").is_file():
        raise InputError("no graphs of the sample", folder, "Run make demo, or name the folder with --data")
    return Street(folder / f"{next(iter(store.read_index(folder, stage='graphs')))}.h5")


def recorded(kitti: Path, path: Path, points: int = POINTS) -> Street:
    """Write graphs of `points` points to `path`, of the first FRAMES scans of a drive of KITTI raw.

    Raises InputError without a drive of as many scans.
    """
    drives = (sorted(folder.glob("data/*.bin")) for folder in sorted(kitti.glob("*/*_sync/velodyne_points")))
    scans = next((scans[:FRAMES] for scans in drives if len(scans) >= FRAMES), None)
    if scans is None:
        raise InputError(f"expected a drive with {FRAMES} scans or more", kitti, "Name KITTI raw with --kitti")
    drive, frame = scans[0].parents[2].name.removesuffix("_sync"), np.arange(FRAMES)
    variant = Variant(source="clouds/lidar", points=points, k=K, keep_inter_class=KEEP_INTER_CLASS)
    graphs = (frame_graph.build(_read(scan, points), variant, drive, number) for number, scan in enumerate(scans))
    with store.DriveWriter(path, stage="graphs", drive=drive, params={"graphs": variant.model_dump()}) as file:
        graph_file.write(file, frame, frame * 0.1, graphs, frame_graph.empty_frame(variant))
    return Street(path)


def _read(path: Path, points: int) -> cloud.Cloud:
    """Return a scan's cloud in camera axes (x right, y down, z forward), with classes by position.

    A scan has no classes, but pruning needs some: road below the car, and one class for each column of 4 m.
    """
    x, y, z = np.fromfile(path, np.float32).reshape(-1, 4)[:, :3].T
    xyz = np.stack([-y, -z, x], axis=1)
    column = np.floor(xyz[:, [0, 2]] / 4).astype(np.int64) @ np.array([7, 13])
    cls = np.where(xyz[:, 1] > 1.4, ROAD, np.array(STANDING)[column % len(STANDING)]).astype(np.uint8)
    return cloud.downsample((xyz, cls), points, np.random.default_rng(0))
