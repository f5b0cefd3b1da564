"""Measure a row of the table, and make a street of random points."""

import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from torch_geometric.data import Data

from models.steering.core.batch import GraphBatch, from_arrays
from pipeline.base import store
from pipeline.camera.classes import BUILDING, ROAD
from pipeline.camera.geometry import CAMERA_HEIGHT_M
from pipeline.clouds.cloud import Cloud
from pipeline.graphs import frame_graph, graph_file
from pipeline.graphs.settings import Variant
from pipeline.train.frames import join, number_rows

ROUNDS = 5
DEVICE = "cuda" if torch.cuda.is_available() else "cpu"
# does the work once and returns the result in the unit of the row
Measurement = Callable[[], float]
FRAMES = 31  # a span of 24 windows of 8 frames
POINTS, K, KEEP_INTER_CLASS = 43_000, 6, 0.2  # paper, Table 1


class Row(NamedTuple):
    """A row of the table: two measurements in `unit`."""

    ours: Measurement
    alternative: Measurement
    unit: str
    what: str

    def measure(self) -> list[float]:
        """Return the medians of both, run once to warm up, then in turn, so that other load affects
        both.
        """
        self.ours(), self.alternative()
        return np.median(
            [(self.ours(), self.alternative()) for _ in range(ROUNDS)], axis=0
        ).tolist()


def milliseconds(work: Callable[[], object], items: int = 1) -> Measurement:
    """Return a measurement of `work` in milliseconds per item, if one call processes `items`."""

    def measure() -> float:
        start = time.perf_counter()
        work()
        if DEVICE == "cuda":
            torch.cuda.synchronize()
        return 1e3 * (time.perf_counter() - start) / items

    return measure


class Street(NamedTuple):
    """A graph file, and its frames as PyTorch Geometric's Data, a file each."""

    title: str
    file: Path
    frames: list[Path]

    def batch(self, count: int, device: str = DEVICE) -> GraphBatch:
        """Return the first `count` frames as a batch of the graph network."""
        with graph_file.open_graphs(self.file) as file:
            batch = from_arrays(number_rows(join([(file, 0, count)]), file), device)
        assert isinstance(batch, GraphBatch)
        return batch


def make_street(folder: Path, points: int) -> Street:
    """Write FRAMES graphs of random `points` on a road and on a wall on either side, in camera
    axes, to `folder`.
    """
    rng, frame = np.random.default_rng(0), np.arange(FRAMES)
    variant = Variant(source="clouds/pseudo", points=points, k=K, keep_inter_class=KEEP_INTER_CLASS)

    def cloud() -> Cloud:
        wall = rng.random(points) < 0.5
        x = np.where(wall, rng.choice([-8.0, 8.0], points), rng.uniform(-8, 8, points))
        y = np.where(wall, rng.uniform(-6, CAMERA_HEIGHT_M, points), CAMERA_HEIGHT_M)
        xyz = np.stack([x, y, rng.uniform(4, 60, points)], axis=1).astype(np.float32)
        return Cloud(xyz, np.where(wall, BUILDING, ROAD).astype(np.uint8))

    graphs = (
        frame_graph.build_frame(cloud(), variant, "street", number) for number in range(FRAMES)
    )
    street = Street(
        f"{points:,} points", folder / "graphs.h5", [folder / f"{number}.pt" for number in frame]
    )
    params = {"graphs": variant.model_dump()}
    with store.DriveWriter(street.file, stage="graphs", drive="street", params=params) as file:
        graph_file.write(file, frame, frame * 0.1, graphs, frame_graph.empty_frame(variant))
    for path, block in zip(street.frames, street.batch(FRAMES, "cpu").blocks(1), strict=True):
        # Float32 points and int64 edges, as PyG's operators need them. Clones: a view would save
        # all frames.
        torch.save(
            Data(pos=block.xyz.clone(), cls=block.cls.long(), edge_index=block.edge_index), path
        )
    return street
