"""Test semantic point clouds, and which of their points are drawn."""

import numpy as np
import pytest

from pipeline.camera import classes, geometry
from pipeline.camera.camera import Camera
from pipeline.clouds import cloud
from tests import artefacts

K = np.array([[100.0, 0, 19.5], [0, 100.0, 9.5], [0, 0, 1]])


def test_pseudo_cloud_has_a_point_per_valid_pixel():
    """Void pixels are points only if no pixel has a class."""
    depth = np.full((20, 40), 10.0)
    cls = np.full((20, 40), classes.ROAD, np.uint8)
    depth[0, 0] = 0.0
    depth[1, 1] = 81.0
    cls[2, 2] = classes.SKY
    cls[3, 3] = classes.VOID
    points = cloud.pseudo_cloud(depth, cls, K, max_depth_m=80.0)
    assert (points.cls == classes.ROAD).all()
    uv, z = geometry.project(points.xyz.astype(np.float64), K)
    assert z == pytest.approx(np.full(len(z), 10.0))
    pixels = [*map(tuple, np.rint(uv).astype(int).tolist())]
    no_points = {(0, 0), (1, 1), (2, 2), (3, 3)}
    assert sorted(pixels) == sorted({(u, v) for u in range(40) for v in range(20)} - no_points)

    void = np.full((20, 40), classes.VOID, np.uint8)
    assert len(cloud.pseudo_cloud(depth, void, K, max_depth_m=80.0).xyz) == 20 * 40 - 2
    limits = cloud.solid_pixels(np.array([[80.0, 80.1]]), np.zeros((1, 2)), max_depth_m=80.0)
    assert limits.tolist() == [[True, False]]


def test_lidar_points_take_the_class_of_their_pixel():
    T_cam_velo = np.array([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])
    camera = Camera(K, (20, 40), T_cam_velo=T_cam_velo)
    cls = np.full((20, 40), classes.CAR, np.uint8)
    cls[:, 20:] = classes.SKY
    # On a car, inside it, on the street behind it, on the sky, behind the camera, beside the image.
    places = [(10, 1, 0), (12, 1.2, 0), (20, 2, 0), (10, -1, 0), (-10, 0, 0), (10, 50, 0)]
    scan = np.array([(*place, 0.5) for place in places], np.float32)
    points = cloud.lidar_cloud(scan, camera, cls)
    assert points.xyz == pytest.approx(np.array([(-y, -z, x) for x, y, z in places]))
    assert points.cls.tolist() == [classes.CAR] * 2 + [classes.VOID] * 4
    assert (cloud.lidar_cloud(scan, camera, None).cls == classes.VOID).all()


def test_morton_order_equals_bitwise_interleaving():
    xyz = np.random.default_rng(0).uniform(-60, 60, (200, 3))
    row = np.arange(200).astype(np.uint8)  # as class, so that it shows the order

    def code(point: np.ndarray) -> int:
        number = 0
        for axis, value in enumerate(point.tolist()):
            cell = round(value * 1024) + 2**20
            for bit in range(21):
                number |= ((cell >> bit) & 1) << (3 * bit + axis)
        return number

    stored, order = cloud.in_morton_order(cloud.Cloud(xyz, row))
    np.testing.assert_array_equal(stored, np.rint(xyz[order] * 1024) / 1024)
    codes = [code(point) for point in stored]
    assert codes == sorted(codes)


def test_drawn_points_depend_on_the_frame_alone_lie_in_the_crop_and_keep_order_and_class():
    xyz, cls = artefacts.points(900)

    def drawn(count: int, frame: int) -> list[int]:
        rng = cloud.frame_rng(0, "drive", frame)
        points = cloud.draw_points(cloud.Cloud(xyz, cls), (-5, 0, 5, 20), count, rng)
        rows = [int(np.flatnonzero((xyz == point).all(axis=1))[0]) for point in points.xyz]
        assert rows == sorted(set(rows))
        assert points.cls.tolist() == cls[rows].tolist()
        return rows

    in_crop = (np.abs(xyz[:, 0]) <= 5) & (xyz[:, 2] >= 0) & (xyz[:, 2] <= 20)
    inside = np.flatnonzero(in_crop).tolist()
    assert drawn(900, 0) == inside
    assert drawn(20, 5) == drawn(20, 5) != drawn(20, 6)
    assert set(drawn(20, 6)) < set(inside)
    assert len(drawn(20, 6)) == 20
