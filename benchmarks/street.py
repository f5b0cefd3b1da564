"""Measure a row of the table, and make a street of random points."""

import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from models.steering.core.batch import GraphBatch, from_arrays
from pipeline.base import store
from pipeline.camera.classes import BUILDING, ROAD
from pipeline.camera.geometry import CAMERA_HEIGHT_M
from pipeline.graphs import frame_graph, graph_file
from pipeline.graphs.cloud import Cloud
from pipeline.settings.graphs import Variant

ROUNDS = 5
DEVICE = "cuda" if torch.cuda.is_available() else "cpu"
Measurement = Callable[[], float]
"""Do the work once and return the result in the unit of the row."""
FRAMES = 31  # a span of 24 windows of 8 frames
POINTS, K, KEEP_INTER_CLASS = 43_000, 6, 0.2  # paper, Table 1


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


def make_street(path: Path, points: int) -> Street:
    """Write FRAMES graphs of random `points` on a road and on a wall on either side, in camera axes, to `path`."""
    rng, frame = np.random.default_rng(0), np.arange(FRAMES)
    variant = Variant(source="clouds/pseudo", points=points, k=K, keep_inter_class=KEEP_INTER_CLASS)

    def cloud() -> Cloud:
        wall = rng.random(points) < 0.5
        x = np.where(wall, rng.choice([-8.0, 8.0], points), rng.uniform(-8, 8, points))
        y = np.where(wall, rng.uniform(-6, CAMERA_HEIGHT_M, points), CAMERA_HEIGHT_M)
        xyz = np.stack([x, y, rng.uniform(4, 60, points)], axis=1).astype(np.float32)
        return xyz, np.where(wall, BUILDING, ROAD).astype(np.uint8)

    graphs = (frame_graph.build(cloud(), variant, "street", number) for number in range(FRAMES))
    with store.DriveWriter(path, stage="graphs", drive="street", params={"graphs": variant.model_dump()}) as file:
        graph_file.write(file, frame, frame * 0.1, graphs, frame_graph.empty_frame(variant))
    return Street(path)
