"""LiDAR odometry on scans of a street of planes along a known path."""

import numpy as np
import open3d as o3d
import pytest

from pipeline.camera.camera import Frame
from pipeline.motion import lidar, step
from tests import rendered_street as street

# velodyne x forward, y left, z up → camera x right, y down, z forward
T_CAM_VELO = np.array([[0.0, -1, 0, 0.1], [0, 0, -1, -0.1], [1, 0, 0, -0.3], [0, 0, 0, 1]])


def world(houses: bool = True) -> np.ndarray:
    """Return points [P,3] in the world frame: road, house fronts and side walls."""
    rng = np.random.default_rng(0)
    x, z = rng.uniform(-20, 20, 9000), rng.uniform(-10, 50, 9000)
    points = [np.stack([x, np.full_like(x, 1.65), z], axis=-1)]
    for corner in range(-10, 50, 10) if houses else ():
        for side in (-7.0, 7.0):
            along, up = rng.uniform(corner, corner + 7, 900), rng.uniform(-5, 1.6, 900)
            points.append(np.stack([np.full_like(up, side), up, along], axis=-1))
            back = side + np.sign(side) * rng.uniform(0, 5, 500)
            points.append(np.stack([back, rng.uniform(-5, 1.6, 500), np.full(500, corner + 7.0)], axis=-1))
    return np.concatenate(points)


def scan(number: int, T_world_cam: np.ndarray, points: np.ndarray) -> Frame:
    T_velo_world = np.linalg.inv(T_world_cam @ T_CAM_VELO)
    seen = np.random.default_rng(number).random(len(points)) < 0.7  # different points in each scan
    xyz = points @ T_velo_world[:3, :3].T + T_velo_world[:3, 3]
    return Frame(number, number * 0.1, scan=xyz[seen].astype(np.float32))


def steps_of(scans: list[Frame]) -> list[step.Step | None]:
    odometry = lidar.Odometry(T_CAM_VELO)
    return [odometry.step(one) for one in scans]


def measured(poses: list[np.ndarray], points: np.ndarray) -> list[step.Step | None]:
    return steps_of([scan(number, pose, points) for number, pose in enumerate(poses)])


@pytest.mark.parametrize(("yaw_rate", "speed"), [(0.4, 6.0), (-0.4, 6.0), (0.0, 12.0)])
def test_known_motion_is_measured(yaw_rate: float, speed: float) -> None:
    first, *steps = measured(street.arc(4, yaw_rate, speed), world())
    assert first is None
    for one in steps:
        assert one
        assert step.rates(one.T_before, 0.1) == pytest.approx((yaw_rate, speed), rel=0.03, abs=0.01)
        assert one.inliers > 300
        assert 0 < one.residual < 0.5


def test_standing_and_too_few_points_are_not_measured() -> None:
    assert measured([np.eye(4)] * 3, world()) == [None] * 3
    assert measured(street.arc(3, 0.0, 6.0), world()[::100]) == [None] * 3


def test_threads_change_no_bit(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lidar, "VOXEL_M", 0.05)  # enough points for several threads
    before = o3d.utility.get_max_threads()
    scans = [scan(number, pose, world()) for number, pose in enumerate(street.arc(3, 0.2, 6.0))]
    found = []
    try:
        for threads in (1, 2, 2):
            o3d.utility.set_max_threads(threads)
            found.append(b"".join(one.T_before.tobytes() for one in steps_of(scans) if one))
            assert o3d.utility.get_max_threads() == threads
    finally:
        o3d.utility.set_max_threads(before)
    assert found[0]
    assert len(set(found)) == 1
