"""Depth in metres, ground truth, and errors of depth and classes."""

import json

import numpy as np
import pytest

from pipeline.base import store
from pipeline.camera import classes
from pipeline.camera.camera import Camera, read_camera, scan_depth
from pipeline.camera.geometry import back_project, rays
from pipeline.perception.depth_scale import (
    DepthPostprocessor,
    from_camera_height,
    ground_plane_depth,
    limit_traffic_depth,
)
from pipeline.perception.scores import Scores, Truth, depth_errors, read_truth, summary_line
from pipeline.settings.perception import Perception
from tests import street

SIZE = (48, 96)
CAMERA = Camera(np.array([[60.0, 0, 47], [0, 60, 20], [0, 0, 1]]), SIZE, T_cam_velo=np.eye(4))
CAR = np.full(SIZE, classes.CAR)


def road(pitch_rad: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Return depth [H,W] in metres of a road 1.65 m below the camera, and its trainIds."""
    along = rays(CAMERA.K, SIZE) @ np.array([0, np.cos(pitch_rad), np.sin(pitch_rad)])
    depth_m = np.where(along > 0.02, 1.65 / np.maximum(along, 0.02), 0)
    return depth_m, np.where(depth_m > 0, classes.ROAD, classes.SKY)


@pytest.mark.parametrize("pitch_rad", [0.0, 0.03, -0.05])
@pytest.mark.parametrize("unit", [0.2, 17.0])
def test_the_road_determines_the_scale_for_any_pitch(pitch_rad, unit):
    depth_m, cls = road(pitch_rad)
    stones = np.random.default_rng(0).random(SIZE) < 0.02
    depth = unit * np.where(stones, 0.97, 1) * depth_m
    assert from_camera_height(depth, cls, CAMERA) == pytest.approx(1 / unit, rel=0.02)
    assert from_camera_height(depth, CAR, CAMERA) is None


def test_a_frame_without_road_takes_the_previous_factor():
    process = DepthPostprocessor(Perception(batch=1, depth_scale="camera_height"), CAMERA)
    assert not process(np.ones(SIZE, np.float32), CAR).any()  # no depth rather than a wrong one
    depth_m, cls = road()
    np.testing.assert_allclose(process((depth_m / 5).astype(np.float32), cls), depth_m, rtol=1e-3, atol=1 / 256)
    np.testing.assert_allclose(process(np.ones(SIZE, np.float32), CAR), 5, rtol=1e-3)


def test_ground_is_a_plane_and_objects_have_the_depth_of_their_foot():
    _, truth, cls = street.scene(0)
    depth = ground_plane_depth(cls, street.CAMERA)
    ground = cls == classes.ROAD
    np.testing.assert_allclose(back_project(depth, street.K)[ground][:, 1], 1.65)
    np.testing.assert_allclose(depth[ground], truth[ground])
    # The street's walls are upright, so each wall pixel is as far as the first road pixel below it, or nearer.
    for column in range(0, street.SIZE[1], 7):
        foot = np.flatnonzero(ground[:, column])[:1]
        if foot.size:
            np.testing.assert_allclose(depth[: foot[0], column], depth[foot[0], column])


def test_only_traffic_is_limited():
    _, truth, cls = street.scene(0)
    cls = cls.copy()
    column = np.flatnonzero((cls == classes.ROAD).any(axis=0) & (cls == classes.BUILDING).any(axis=0))[0]
    lorry = np.zeros(cls.shape, bool)
    lorry[:, column] = cls[:, column] == classes.BUILDING
    cls[lorry] = classes.TRUCK
    depth = np.where(lorry, 70.0, truth)
    limit_traffic_depth(depth, cls, street.CAMERA, reach=1.1)
    np.testing.assert_array_equal(depth[~lorry], truth[~lorry])
    np.testing.assert_allclose(depth[lorry], 1.1 * ground_plane_depth(cls, street.CAMERA)[lorry])
    near = np.where(lorry, 2.0, truth)
    limit_traffic_depth(near, cls, street.CAMERA, reach=1.1)
    assert (near[lorry] == 2.0).all()


DRIVE = "2026_01_01_drive_0001"


@pytest.mark.parametrize("dense", [True, False])
def test_dense_truth_precedes_lidar_which_is_sparse_and_has_no_classes(tmp_path, dense):
    street.write_drive(tmp_path, DRIVE, 2, dense=dense, lidar=True)
    _, depth, cls = street.scene(1)
    with store.DriveReader(tmp_path / f"{DRIVE}.h5", stage="ingest") as file:
        truth = read_truth(file, read_camera(file), 1)
    hit = np.zeros(street.SIZE, bool)
    hit[::2, ::4] = True
    np.testing.assert_allclose(truth.depth_m, np.where(hit | dense, depth, 0), rtol=1e-4, atol=0.5 / 256 + 1e-6)
    np.testing.assert_array_equal(truth.cls, cls if dense else classes.VOID)
    assert (truth.depth_source, truth.has_cls) == (("dense", True) if dense else ("lidar", False))


def test_hidden_points_are_dropped_and_ground_stays():
    camera = Camera(np.array([[360.0, 0, 160], [0, 360, 40], [0, 0, 1]]), (100, 320), T_cam_velo=np.eye(4))
    rows = np.arange(100)[:, None]
    ground = np.where(rows > 45, 1.65 * 360 / np.maximum(rows - 40, 1), 0) * np.ones((1, 320))
    ground[:, 1::3] = 0
    wall = ground.copy()
    wall[20:80:2, 100:140:2] = 6.0  # a car, and street points behind it between its own
    kept, ground_kept = (scan_depth(back_project(depth, camera.K)[depth > 0], camera) for depth in (wall, ground))
    np.testing.assert_allclose(ground_kept, ground, rtol=1e-6)
    np.testing.assert_allclose(kept[20:80:2, 100:140:2], 6.0)
    hidden = np.zeros_like(wall, bool)
    hidden[46:79, 100:139] = wall[46:79, 100:139] > 7.5
    assert hidden.any()
    assert not kept[hidden].any()
    np.testing.assert_array_equal(kept[:, :98], ground_kept[:, :98])


@pytest.mark.parametrize(
    ("truth", "predicted", "expected"),
    [
        ([10, 20, 0, 0.9, 81, 40], [11, 30, 5, 5, 5, 40], [(0.1 + 0.5) / 3, np.sqrt(101 / 3), 2 / 3]),  # out of range
        ([80, 1], [1000, 0.1], [0, 0, 1]),  # clipped
        ([10, 20, 40], [11, 0, 40], [0.05, np.sqrt(1 / 2), 1]),  # a hole in the prediction
    ],
)
def test_depth_errors_equal_hand_values(truth, predicted, expected):
    np.testing.assert_allclose(depth_errors(np.array(predicted), np.array(truth, float)), expected)


def test_flat_ground_is_scored_at_the_pixels_of_the_encoder():
    _, depth_m, cls = street.scene(0)
    stored = np.where(np.random.default_rng(0).random(street.SIZE) < 0.3, 0, depth_m)
    scores = Scores()
    scores.add_frame(stored, cls, street.CAMERA, Truth(depth_m, "dense", cls, has_cls=True))
    report = scores.report()
    flat = np.where(stored > 0, ground_plane_depth(cls, street.CAMERA), 0)
    assert report["depth_dense"]["abs_rel"] == 0
    assert report["ground_plane_dense"]["abs_rel"] == pytest.approx(depth_errors(flat, depth_m)[0])
    assert 0.5 < report["depth_dense"]["coverage"] == report["ground_plane_dense"]["coverage"] < 0.8
    assert report["depth_lidar"] is None
    assert report["classes"]["pixel_accuracy"] == 1
    assert "abs rel 0.000" in summary_line(report)
    assert "mean IoU 1.000" in summary_line(report)


def test_class_scores_equal_hand_values():
    scores = Scores()
    truth = np.array([0, 0, 0, 1, 1, classes.VOID, 18, 18])
    scores.add_classes(np.array([0, 0, 1, 1, 2, 5, 18, classes.VOID], np.uint8), truth)  # void is an error
    report = scores.report()["classes"]
    ious = {classes.NAMES[0]: 2 / 3, classes.NAMES[1]: 1 / 3, classes.NAMES[18]: 1 / 2}  # 2 is not in the truth
    assert report["iou"] == pytest.approx(ious)
    assert report["mean_iou"] == pytest.approx(1 / 2)
    assert report["pixel_accuracy"] == pytest.approx(4 / 7)


def test_scores_add_up_over_drives_through_json():
    rng, every, total = np.random.default_rng(0), Scores(), Scores()
    for _ in range(2):
        part, (depth, truth), (cls, true_cls) = Scores(), rng.uniform(2, 60, (2, 5, 6)), rng.integers(0, 4, (2, 5, 6))
        for scores in (every, part):
            scores.add_depth("depth_dense", depth, truth)
            scores.add_classes(cls, true_cls)
        total.add(json.loads(json.dumps({key: sums.tolist() for key, sums in part.sums.items()})))
    assert total.report()["depth_dense"] == pytest.approx(every.report()["depth_dense"])
    assert total.report()["classes"] == every.report()["classes"]
    assert set(Scores().report().values()) == {None}
