"""One frame of a graph and of an ingest file."""

from pathlib import Path

import numpy as np
import pytest

from pipeline.base.store import DriveReader
from pipeline.camera.camera import Camera, Frame
from pipeline.kitti import ingest_file
from pipeline.settings.ingest import Reading
from pipeline.show import frame_view
from tests.artefacts import write_graphs

DRIVE = "2011_09_26_drive_0001"
FRAMES = np.array([3, 4, 6])


@pytest.fixture
def graphs(tmp_path: Path) -> Path:
    write_graphs(tmp_path / "graphs/a.h5", DRIVE, np.zeros(3), FRAMES, 40, np.random.default_rng(0))
    return tmp_path / "graphs/a.h5"


def test_graph_has_each_edge_once(graphs: Path) -> None:
    view, numbers = frame_view.read(graphs, 4)
    assert view.edges is not None
    with DriveReader(graphs, stage="graphs") as file:
        xyz, degree = file["xyz"][40:80], file["degree"][40:80]
        start, stop = file["indices_ptr"][1:3]
        indices = file["indices"][start:stop]
    np.testing.assert_array_equal(view.xyz, xyz)
    both = {(a, b) for a, row in enumerate(np.split(indices, np.cumsum(degree)[:-1])) for b in row.tolist()}
    edges = [(a, b) for a, b in view.edges.tolist()]
    assert len(edges) == len(set(edges)) == len(both) / 2
    assert {*edges, *((b, a) for a, b in edges)} == both
    assert numbers["edges_knn"] == 240


def test_ingest_has_images_ground_truth_and_scans(tmp_path: Path) -> None:
    rng, path = np.random.default_rng(0), tmp_path / "ingest/a.h5"
    image, cls = rng.integers(0, 256, (32, 48, 3), np.uint8), rng.integers(0, 19, (32, 48), np.uint8)
    frames = [Frame(number, number / 10) for number in FRAMES.tolist()]
    scan = np.array([[10, 2, -1.7, 0.5]], np.float32)
    frames[1] = Frame(4, 0.4, image, np.full((32, 48), 7.0), cls, scan)
    ingest_file.ingest_drive(
        frames,
        path,
        drive=DRIVE,
        camera=Camera(np.array([[20, 0, 15], [0, 20, 10], [0, 0, 1]], float), (32, 48)),
        settings=Reading(image_size=(32, 48), cameras=[2], lidar=True, on_damaged="fail"),
        truth=("depth", "cls"),
    )
    view, _ = frame_view.read(path, 4)
    np.testing.assert_array_equal(view.rgb, image)
    np.testing.assert_array_equal(view.depth_m, np.full((32, 48), 7.0))
    np.testing.assert_array_equal(view.cls, cls)
    np.testing.assert_allclose(view.xyz, [[-2, 1.7, 10]], atol=1e-6)
    assert not frame_view.is_drawable(frame_view.read(path, 3)[0])
