import numpy as np
import pytest

from pipeline.camera import classes
from pipeline.camera.camera import Camera
from pipeline.camera.geometry import back_project, rays
from pipeline.camera.images import to_units
from pipeline.perception.depth_scale import (
    DepthPostprocessor,
    from_camera_height,
    ground_plane_depth,
    limit_traffic_depth,
)
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
def test_the_road_determines_the_scale_for_any_pitch(pitch_rad: float, unit: float) -> None:
    depth_m, cls = road(pitch_rad)
    stones = np.random.default_rng(0).random(SIZE) < 0.02
    depth = unit * np.where(stones, 0.97, 1) * depth_m
    assert from_camera_height(depth, cls, CAMERA) == pytest.approx(1 / unit, rel=0.02)
    assert from_camera_height(depth, CAR, CAMERA) is None


def test_stored_depth_is_rounded_clipped_and_empty_in_the_sky() -> None:
    depth = np.array([[1.0, 10.002, 1000.0, 0.0001, 30.0, 0.0]], np.float32)
    cls = np.array([[0, 0, 0, 0, classes.SKY, 0]])
    process = DepthPostprocessor(Perception(batch=1, depth_scale="metric"), CAMERA)
    assert to_units(process(depth, cls)).tolist() == [[256, 2561, 65535, 1, 0, 0]]


def test_a_frame_without_road_takes_the_previous_factor() -> None:
    process = DepthPostprocessor(Perception(batch=1, depth_scale="camera_height"), CAMERA)
    assert not process(np.ones(SIZE, np.float32), CAR).any()  # no depth rather than a wrong one
    depth_m, cls = road()
    np.testing.assert_allclose(process((depth_m / 5).astype(np.float32), cls), depth_m, rtol=1e-3, atol=1 / 256)
    np.testing.assert_allclose(process(np.ones(SIZE, np.float32), CAR), 5, rtol=1e-3)


def test_ground_is_a_plane_and_objects_have_the_depth_of_their_foot() -> None:
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


def test_only_traffic_is_limited() -> None:
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
