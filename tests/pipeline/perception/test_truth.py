from pathlib import Path

import numpy as np

from pipeline.base import store
from pipeline.camera import classes
from pipeline.camera.camera import Camera, read_camera
from pipeline.perception.truth import read_truth, visible
from tests import street

DRIVE = "2026_01_01_drive_0001"


def test_dense_truth_is_read_as_metres_and_classes(tmp_path: Path) -> None:
    street.write_drive(tmp_path, DRIVE, 2, dense=True, lidar=True)
    _, depth, cls = street.scene(1)
    with store.DriveReader(tmp_path / f"{DRIVE}.h5", stage="ingest") as file:
        truth = read_truth(file, read_camera(file), 1)
    assert truth.depth_source == "dense"
    np.testing.assert_allclose(truth.depth_m, depth, atol=0.5 / 256 + 1e-6)
    np.testing.assert_array_equal(truth.cls, cls)


def test_lidar_truth_is_sparse_and_has_no_classes(tmp_path: Path) -> None:
    street.write_drive(tmp_path, DRIVE, 2, dense=False, lidar=True)
    _, depth, _ = street.scene(1)
    with store.DriveReader(tmp_path / f"{DRIVE}.h5", stage="ingest") as file:
        truth = read_truth(file, read_camera(file), 1)
    hit = np.zeros(street.SIZE, bool)
    hit[::2, ::4] = depth[::2, ::4] > 0
    np.testing.assert_array_equal(truth.depth_m > 0, hit)
    np.testing.assert_allclose(truth.depth_m[hit], depth[hit], rtol=1e-4)
    assert truth.depth_source == "lidar"
    assert not truth.has_cls
    assert (truth.cls == classes.VOID).all()


def test_hidden_points_are_dropped_and_ground_stays() -> None:
    camera = Camera(np.array([[360.0, 0, 160], [0, 360, 40], [0, 0, 1]]), (100, 320))
    rows = np.arange(100)[:, None]
    ground = np.where(rows > 45, 1.65 * 360 / np.maximum(rows - 40, 1), 0) * np.ones((1, 320))
    ground[:, 1::3] = 0
    np.testing.assert_array_equal(visible(ground, camera), ground)
    wall = ground.copy()
    wall[20:80:2, 100:140:2] = 6.0  # a car, and street points behind it between its own
    kept = visible(wall, camera)
    np.testing.assert_array_equal(kept[20:80:2, 100:140:2], 6.0)
    hidden = np.zeros_like(wall, bool)
    hidden[46:79, 100:139] = wall[46:79, 100:139] > 7.5
    assert hidden.any()
    assert not kept[hidden].any()
    np.testing.assert_array_equal(kept[:, :98], ground[:, :98])
