"""One frame of a graph and of an ingest file."""

from pathlib import Path

import numpy as np
import pytest

from pipeline.base.store import DriveReader, DriveWriter
from pipeline.camera.camera import Camera, write_camera
from pipeline.camera.images import to_units
from pipeline.kitti import ingest_file
from pipeline.kitti.oxts import make_rows
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
    image, cls = rng.integers(0, 256, (20, 30, 3), np.uint8), rng.integers(0, 19, (20, 30), np.uint8)
    with DriveWriter(path, stage="ingest", drive=DRIVE, params={}) as file:
        ingest_file.put_motion(file, FRAMES, FRAMES * 0.1, make_rows(3))
        write_camera(file, Camera(np.array([[20, 0, 15], [0, 20, 10], [0, 0, 1]], float), (20, 30)))
        ingest_file.put_pixels(file, "image", 3, (20, 30), [(1, image)])
        ingest_file.put_pixels(file, "depth", 3, (20, 30), [(1, to_units(np.full((20, 30), 7.0)))])
        ingest_file.put_pixels(file, "cls", 3, (20, 30), [(1, cls)])
        ingest_file.put_scans(file, 3, [(1, np.array([[10, 2, -1.7, 0.5]], np.float32))])
    view, _ = frame_view.read(path, 4)
    np.testing.assert_array_equal(view.rgb, image)
    np.testing.assert_array_equal(view.depth_m, np.full((20, 30), 7.0))
    np.testing.assert_array_equal(view.cls, cls)
    np.testing.assert_allclose(view.xyz, [[-2, 1.7, 10]], atol=1e-6)
    assert not frame_view.is_drawable(frame_view.read(path, 3)[0])
