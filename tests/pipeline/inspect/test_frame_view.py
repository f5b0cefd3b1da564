"""A frame's images, points and edges are those of the artefact; a picture and a PLY file show them."""

from pathlib import Path

import cv2
import h5py
import numpy as np
import pytest

from pipeline.base.errors import InputError
from pipeline.base.store import DriveReader, DriveWriter
from pipeline.camera import classes
from pipeline.camera.images import to_units
from pipeline.inspect import frame_picture, frame_view, points
from pipeline.inspect.frame_view import FrameView
from pipeline.kitti import ingest_file
from pipeline.kitti.oxts import make_rows
from tests import kitti_drive
from tests.artefacts import write_graphs, write_images, write_labels, write_sets

DRIVE = "2011_09_26_drive_0001"
FRAMES = np.array([3, 4, 6])


@pytest.fixture
def graphs(tmp_path: Path) -> Path:
    write_graphs(tmp_path / "graphs/a.h5", DRIVE, np.zeros(3), FRAMES, 40, np.random.default_rng(0))
    return tmp_path / "graphs/a.h5"


def test_a_graph_has_each_of_its_edges_once(graphs: Path) -> None:
    view = frame_view.of_file(graphs, 4)
    assert view.cloud is not None
    assert view.edges is not None
    with DriveReader(graphs, stage="graphs") as file:
        np.testing.assert_array_equal(view.cloud[0], file["xyz"][40:80])
        start, stop = file["indices_ptr"][1:3]
        degree, indices = file["degree"][40:80], file["indices"][start:stop]
    lists = np.split(indices, np.cumsum(degree)[:-1])
    matrix = np.zeros((40, 40), bool)
    matrix[view.edges[:, 0], view.edges[:, 1]] = True
    assert matrix.sum() == len(view.edges)
    for row, neighbours in zip(matrix | matrix.T, lists, strict=True):
        np.testing.assert_array_equal(np.flatnonzero(row), neighbours)
    assert view.values["edges_knn"] == 240


def test_the_first_frame_is_taken_and_one_that_is_not_there_is_told_by_its_neighbours(graphs: Path) -> None:
    assert frame_view.of_file(graphs, None).frame == 3
    with pytest.raises(InputError, match="no frame 9: it has 3 to 6, the nearest is 6"):
        frame_view.of_file(graphs, 9)


def test_sets_have_their_centres_and_images_their_image(tmp_path: Path) -> None:
    for name, write in (("sets", write_sets), ("images", write_images)):
        write(tmp_path / f"graphs/{name}.h5", DRIVE, np.zeros(3), FRAMES, 40, np.random.default_rng(0))
    sets = frame_view.of_file(tmp_path / "graphs/sets.h5", 3)
    assert sets.centres is not None
    assert len(sets.centres) == 16
    image = frame_view.of_file(tmp_path / "graphs/images.h5", 6)
    assert image.rgb is not None
    assert image.rgb.shape == (32, 48, 3)
    assert image.cloud is None


def test_labels_are_numbers_alone(tmp_path: Path) -> None:
    write_labels(tmp_path / "labels/a.h5", DRIVE, np.array([0.1, 0.2, 0.3]), FRAMES)
    view = frame_view.of_file(tmp_path / "labels/a.h5", 4)
    assert view.values["steering_rad"] == pytest.approx(0.2)
    assert not view.drawable
    with pytest.raises(InputError, match="nothing to draw"):
        frame_picture.draw(tmp_path / "a.png", "a", view)


def test_ingest_has_images_truth_and_scans_where_the_frame_has_them(tmp_path: Path) -> None:
    rng, path = np.random.default_rng(0), tmp_path / "ingest/a.h5"
    image, cls = rng.integers(0, 256, (20, 30, 3), np.uint8), rng.integers(0, 19, (20, 30), np.uint8)
    with DriveWriter(path, stage="ingest", drive=DRIVE, params={}) as file:
        ingest_file.put_motion(file, FRAMES, FRAMES * 0.1, make_rows(3))
        ingest_file.put_camera(file, np.array([[20, 0, 15], [0, 20, 10], [0, 0, 1]], float), None)
        ingest_file.put_pixels(file, "image", 3, (20, 30), [(1, image)])
        ingest_file.put_pixels(file, "depth", 3, (20, 30), [(1, to_units(np.full((20, 30), 7.0)))])
        ingest_file.put_pixels(file, "cls", 3, (20, 30), [(1, cls)])
        ingest_file.put_scans(file, 3, [(1, np.array([[10, 2, -1.7, 0.5]], np.float32))])
    view = frame_view.of_file(path, 4)
    np.testing.assert_array_equal(view.rgb, image)
    np.testing.assert_array_equal(view.depth_m, np.full((20, 30), 7.0))
    np.testing.assert_array_equal(view.cls, cls)
    assert view.cloud is not None
    np.testing.assert_allclose(view.cloud[0], [[-2, 1.7, 10]], atol=1e-6)  # without calibration: axes alone
    assert not frame_view.of_file(path, 3).drawable


def test_a_raw_drive_shows_its_image_and_scan(tmp_path: Path) -> None:
    folder = kitti_drive.write_drive(tmp_path, frames=[0, 5], camera=0)
    view = frame_view.read(folder, 5)
    assert view.rgb is not None
    assert view.cloud is not None
    np.testing.assert_array_equal(
        view.rgb[..., 0], cv2.imread(str(folder / "image_00/data/0000000005.png"), cv2.IMREAD_UNCHANGED)
    )
    assert np.median(view.cloud[0][:, 1]) > 0  # the camera's y points down, to the road
    with pytest.raises(InputError, match="several drives or none"):
        frame_view.read(tmp_path, 0)


def test_degrees_that_are_not_of_the_neighbours_are_damage(graphs: Path) -> None:
    with h5py.File(graphs, "a") as file:
        file["degree"][0] += 1
    with pytest.raises(InputError, match="degrees and neighbours do not belong together"):
        frame_view.of_file(graphs, 3)


def test_a_picture_of_everything_is_drawn_alike_twice(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    xyz, cls = rng.uniform(1, 20, (50, 3)), rng.integers(0, 19, 50).astype(np.uint8)
    image = rng.integers(0, 256, (20, 60, 3), np.uint8)
    edges = rng.integers(0, 50, (80, 2))
    view = FrameView(3, {}, image, rng.uniform(0, 60, (20, 60)), image[..., 0] % 19, (xyz, cls), edges, np.arange(5))
    for name in ("a.png", "b.png"):
        frame_picture.draw(tmp_path / name, "title", view)
    drawn = cv2.imread(str(tmp_path / "a.png"))
    assert drawn is not None
    assert drawn.std() > 10
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()
    with pytest.raises(InputError, match=r"no name of a PNG"):
        frame_picture.draw(tmp_path / "a.jpg", "title", view)


def test_a_ply_file_has_points_colours_and_classes(tmp_path: Path) -> None:
    import open3d

    xyz, cls = np.array([[1, 2, 3], [4, 5, 6]], np.float32), np.array([classes.ROAD, classes.CAR], np.uint8)
    assert points.write_ply(tmp_path / "a.ply", "title", (xyz, cls)) == 2
    read = open3d.t.io.read_point_cloud(tmp_path / "a.ply")
    np.testing.assert_array_equal(read.point.positions.numpy(), xyz)
    np.testing.assert_array_equal(read.point.colors.numpy(), classes.COLOURS[cls])
    np.testing.assert_array_equal(read.point.label.numpy()[:, 0], cls)
    with pytest.raises(InputError, match="there are no points"):
        points.write_ply(tmp_path / "a.ply", "title", None)
    with pytest.raises(InputError, match="no name of a PLY"):
        points.write_ply(tmp_path / "a.pcd", "title", (xyz, cls))


def test_the_viewer_gets_the_points_where_there_is_a_display(monkeypatch: pytest.MonkeyPatch) -> None:
    import open3d

    shown = []
    monkeypatch.setattr(open3d.visualization, "draw_geometries", lambda clouds, **_: shown.extend(clouds))
    cloud = (np.ones((4, 3), np.float32), np.zeros(4, np.uint8))
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    monkeypatch.delenv("DISPLAY", raising=False)
    with pytest.raises(InputError, match="no display"):
        points.view("title", cloud)
    monkeypatch.setenv("DISPLAY", ":0")
    points.view("title", cloud)
    assert len(shown[0].points) == 4


@pytest.mark.parametrize("name", ["image_02/data/0000000001.png", "velodyne_points/data/0000000001.bin"])
def test_a_raw_file_that_has_no_end_is_not_read(tmp_path: Path, name: str) -> None:
    folder = kitti_drive.write_drive(tmp_path, frames=[0, 1])
    (folder / name).unlink()
    (folder / name).symlink_to("/dev/zero")
    with pytest.raises(InputError, match="is no plain file"):
        frame_view.read(folder, 1)
