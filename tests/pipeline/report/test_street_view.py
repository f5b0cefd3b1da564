"""One frame, as files of several stages have it."""

from pathlib import Path

import numpy as np

from pipeline.base.store import DriveReader
from pipeline.report.street_view import read_view
from tests import street
from tests.artefacts import write_graphs

DRIVE = "2011_09_26_drive_0001"


def test_a_graph_has_each_edge_once(tmp_path: Path) -> None:
    path = tmp_path / "graphs/a.h5"
    write_graphs(path, DRIVE, np.zeros(3), np.array([3, 4, 6]), 40, np.random.default_rng(0))
    with DriveReader(path, stage="graphs") as file:
        view = read_view(4, file)
        xyz, degree = file["xyz"][40:80], file["degree"][40:80]
        start, stop = file["indices_ptr"][1:3]
        indices = file["indices"][start:stop]
    assert view.edges is not None
    np.testing.assert_array_equal(view.xyz, xyz)
    both = {(a, b) for a, row in enumerate(np.split(indices, np.cumsum(degree)[:-1])) for b in row.tolist()}
    edges = [(a, b) for a, b in view.edges.tolist()]
    assert len(edges) == len(set(edges)) == len(both) / 2
    assert {*edges, *((b, a) for a, b in edges)} == both


def test_a_later_file_replaces_what_an_earlier_one_has(tmp_path: Path) -> None:
    """The image of ingest; depth and classes of perception, not the ground truth beside the image."""
    street.write_drive(tmp_path / "ingest", DRIVE, 3)
    street.write_perception(tmp_path / "perception", tmp_path / "ingest", DRIVE)
    image, depth_m, cls = street.scene(2)
    with (
        DriveReader(tmp_path / f"ingest/{DRIVE}.h5", stage="ingest") as raw,
        DriveReader(tmp_path / f"perception/{DRIVE}.h5", stage="perception") as perceived,
    ):
        view = read_view(2, raw, perceived)
    np.testing.assert_array_equal(view.rgb, image)
    np.testing.assert_allclose(view.depth_m, depth_m, atol=0.01)
    np.testing.assert_array_equal(view.cls, cls)
    assert [*view.images()] == ["frame 2", "depth", "classes"]
    assert view.xyz is None
