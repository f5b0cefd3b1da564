"""Measure a row of the table, and provide graphs: of recorded scans with the paper's number of points, or the sample's.

This project and an alternative run on the same arrays, in turn; medians count.
"""

import statistics
import time
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
import yaml

from models.steering.core.batch import GraphBatch, from_arrays
from pipeline.base import store
from pipeline.base.errors import InputError
from pipeline.graphs import cloud, graph_file
from pipeline.motion import motion_file
from stages import graphs

ROUNDS = 5
DEVICE = "cuda" if torch.cuda.is_available() else "cpu"
Measurement = Callable[[], float]
"""Do the work once and return the result in the unit of the row."""
FRAMES = 31  # a run of 24 windows of 8 frames
POINTS, K, KEEP_INTER_CLASS = 43_000, 6, 0.2  # paper, Table 1
VARIANT = "semantic"
SOURCE = "clouds/lidar"
ROAD, STANDING = 0, (2, 8, 13, 5)  # trainIds: road; building, vegetation, car, pole


@dataclass(frozen=True)
class Row:
    """Medians in `unit`; `ratio` above 1: this project is better by that factor. Without alternative both are None."""

    ours: float
    alternative: float | None
    unit: str
    ratio: float | None
    what: str


def compare(ours: Measurement, alternative: Measurement, unit: str, what: str) -> Row:
    """Run both once to warm up, then in turn, so that other load on the machine affects both."""
    ours(), alternative()
    results = [(ours(), alternative()) for _ in range(ROUNDS)]
    first, second = (statistics.median(column) for column in zip(*results, strict=True))
    return row(first, second, unit, what)


def row(ours: float, alternative: float, unit: str, what: str) -> Row:
    """Return the row of two results."""
    ratio = ours / alternative if unit.endswith("/s") else alternative / ours
    return Row(ours, alternative, unit, ratio, what)


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

    def arrays(self, count: int) -> graph_file.Arrays:
        """Return the arrays of the first `count` frames, as networks take them."""
        with graph_file.open_graphs(self.file) as file:
            return file.read(0, count)

    def batch(self, count: int, device: str = DEVICE) -> GraphBatch:
        """Return the first `count` frames as a batch of the graph network."""
        batch = from_arrays(self.arrays(count))
        assert isinstance(batch, GraphBatch)
        return batch.to(device)

    def clouds(self, count: int) -> list[cloud.Cloud]:
        """Return points [P,3] and trainIds [P] of the first `count` frames."""
        arrays = self.arrays(count)
        ends = arrays["ptr"][1:-1]
        return list(zip(np.split(arrays["xyz"], ends), np.split(arrays["cls"], ends), strict=True))


def sample(data: Path) -> Street:
    """Return the first training drive of the sample. Raises InputError if ``make demo`` has not written it."""
    folder = data / "graphs" / VARIANT
    if not (folder / "index.json").is_file():
        raise InputError("no graphs of the sample", folder, "Run make demo, or name the folder with --data")
    return Street(folder / f"{next(iter(store.read_index(folder, stage='graphs')))}.h5")


def recorded(kitti: Path, folder: Path, points: int = POINTS) -> Street:
    """Make graphs of recorded scans with the project's own stage `graphs`, in `folder`.

    Args:
        kitti: contains 2011_09_26/2011_09_26_drive_0052_sync/velodyne_points/…; the shortest drive with FRAMES scans
            is used.
        points: per frame.
    Raises: InputError without such a drive.
    """
    scans = defaultdict(list)
    for path in sorted(kitti.glob("*/*_sync/velodyne_points/data/*.bin")):
        scans[path.parents[2].name.removesuffix("_sync")].append(path)
    drives = sorted((len(paths), drive) for drive, paths in scans.items() if len(paths) >= FRAMES)
    if not drives:
        raise InputError(f"expected a drive with {FRAMES} scans or more", kitti, "Name KITTI raw with --kitti")
    drive = drives[0][1]
    frame = np.arange(FRAMES)
    with store.DriveWriter(folder / SOURCE / f"{drive}.h5", stage="clouds", drive=drive, params={}) as file:
        cloud.write(file, frame, frame * 0.1, (_read(path, points) for path in scans[drive][:FRAMES]))
    store.write_index(folder / SOURCE, {drive: "train"})
    motion_file.write_index(folder / "motion", [])
    variant = {"source": SOURCE, "points": points, "k": K, "keep_inter_class": KEEP_INTER_CLASS}
    params = folder / "params.yaml"
    params.write_text(yaml.safe_dump({"graphs": {VARIANT: variant}}), encoding="utf-8")
    graphs.main(VARIANT, folder, folder / "graphs", params, workers=1)
    return Street(folder / "graphs" / VARIANT / f"{drive}.h5")


def _read(path: Path, points: int) -> cloud.Cloud:
    """Return a scan's cloud in camera axes (x right, y down, z forward), with classes by position.

    A scan has no classes, but pruning needs some: road below the car, and one class for each column of 4 m.
    """
    x, y, z = np.fromfile(path, np.float32).reshape(-1, 4)[:, :3].T
    xyz = np.stack([-y, -z, x], axis=1)
    column = np.floor(xyz[:, [0, 2]] / 4).astype(np.int64) @ np.array([7, 13])
    cls = np.where(xyz[:, 1] > 1.4, ROAD, np.array(STANDING)[column % len(STANDING)]).astype(np.uint8)
    return cloud.downsample((xyz, cls), points, np.random.default_rng(0))
