import numpy as np
import pytest

from pipeline.camera import classes, geometry
from pipeline.graphs import cloud

K = np.array([[100.0, 0, 19.5], [0, 100.0, 9.5], [0, 0, 1]])


def random_cloud(points: int, seed: int = 0) -> cloud.Cloud:
    rng = np.random.default_rng(seed)
    return rng.uniform(-20, 20, (points, 3)).astype(np.float32), np.arange(points, dtype=np.uint8) % 19


def test_pseudo_cloud_has_a_point_per_valid_pixel() -> None:
    depth = np.full((20, 40), 10.0)
    cls = np.full((20, 40), classes.ROAD, np.uint8)
    depth[0, 0], depth[1, 1] = 0.0, 81.0
    cls[2, 2], cls[3, 3] = classes.SKY, classes.VOID
    xyz, labels = cloud.pseudo_cloud(depth, cls, K, max_depth_m=80.0)
    assert (labels == classes.ROAD).all()
    uv, z = geometry.project(xyz.astype(np.float64), K)
    assert z == pytest.approx(np.full(len(z), 10.0))
    pixels = set(map(tuple, np.rint(uv).astype(int).tolist()))
    assert pixels == {(u, v) for u in range(40) for v in range(20)} - {(0, 0), (1, 1), (2, 2), (3, 3)}
    assert len(xyz) == len(labels) == len(pixels)


def test_without_classes_each_pixel_with_depth_is_a_point() -> None:
    depth = np.full((20, 40), 10.0)
    depth[0, 0] = 0.0
    xyz, labels = cloud.pseudo_cloud(depth, np.full((20, 40), classes.VOID, np.uint8), K, max_depth_m=80.0)
    assert len(xyz) == 20 * 40 - 1
    assert (labels == classes.VOID).all()


def test_lidar_points_take_the_class_of_their_pixel() -> None:
    T_cam_velo = np.array([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])
    cls = np.full((20, 40), classes.CAR, np.uint8)
    cls[:, 20:] = classes.SKY
    scan = np.array([[10.0, 1, 0, 0.5], [10, -1, 0, 0.5], [-10, 0, 0, 0.5], [10, 50, 0, 0.5]], np.float32)
    xyz, labels = cloud.lidar_cloud(scan, T_cam_velo, K, cls)
    assert xyz == pytest.approx(np.array([[-1, 0, 10], [1, 0, 10], [0, 0, -10], [-50, 0, 10]]))
    # On a car, on the sky, behind the camera, beside the image.
    assert labels.tolist() == [classes.CAR, classes.VOID, classes.VOID, classes.VOID]
    assert (cloud.lidar_cloud(scan, T_cam_velo, K, None)[1] == classes.VOID).all()


def test_sample_is_a_sorted_subset_that_depends_on_the_frame_alone() -> None:
    drawn, again, other = (cloud.sample(1000, 100, cloud.frame_rng(0, "drive", frame)) for frame in (5, 5, 6))
    assert len(set(drawn.tolist())) == 100
    assert (np.diff(drawn) > 0).all()
    assert (drawn == again).all()
    assert (drawn != other).any()
    assert cloud.sample(3, 100, cloud.frame_rng(0, "", 0)).tolist() == [0, 1, 2]


def test_morton_order_equals_bitwise_interleaving() -> None:
    xyz = cloud.quantise(np.random.default_rng(0).uniform(-60, 60, (200, 3)))

    def code(point: np.ndarray) -> int:
        cells = [int(np.floor(value * 1024)) + 2**20 for value in point]
        return sum(((cells[axis] >> bit) & 1) << (3 * bit + axis) for bit in range(21) for axis in range(3))

    order = cloud.morton_order(xyz)
    assert sorted(order.tolist()) == list(range(200))
    assert [code(point) for point in xyz[order]] == sorted(code(point) for point in xyz)


def test_sampled_points_lie_in_the_crop_and_keep_order_and_class() -> None:
    xyz, cls = random_cloud(300)
    points, labels = cloud.sample_points((xyz, cls), (-5, 0, 5, 20), 20, cloud.frame_rng(0, "drive", 0))
    assert len(points) == 20
    assert (np.abs(points[:, 0]) <= 5).all()
    assert (points[:, 2] >= 0).all()
    rows = [int(np.flatnonzero((xyz == point).all(axis=1))[0]) for point in points]
    assert rows == sorted(rows)
    assert labels.tolist() == cls[rows].tolist()


def test_sampling_by_range_draws_equal_numbers_and_fills_up_from_where_points_are_left() -> None:
    """Of 1,000 points 700 are nearer than 10 m, 200 at 10 to 20 m, 90 at 20 to 40 m, 10 beyond."""
    rng, cls = np.random.default_rng(0), np.arange(1000).astype(np.uint8)
    range_m = np.repeat([7.0, 15.0, 30.0, 60.0], [700, 200, 90, 10])
    bearing = rng.uniform(-1, 1, 1000)
    xyz = np.stack([range_m * np.sin(bearing), rng.uniform(-1, 2, 1000), range_m * np.cos(bearing)], axis=1)
    cloud_of_ranges = xyz.astype(np.float32), cls

    def drawn(points: int, seed: int = 0) -> list[int]:
        sampled, labels = cloud.sample_points(cloud_of_ranges, None, points, np.random.default_rng(seed), "range")
        rows = [int(np.flatnonzero((cloud_of_ranges[0] == point).all(axis=1))[0]) for point in sampled]
        assert rows == sorted(rows)
        assert labels.tolist() == cls[rows].tolist()
        return rows

    def counts(rows: list[int]) -> list[int]:
        return [int((range_m[rows] == value).sum()) for value in (7, 15, 30, 60)]

    assert counts(drawn(40)) == [10, 10, 10, 10]
    assert counts(drawn(250)) == [80, 80, 80, 10]
    assert counts(drawn(500)) == [200, 200, 90, 10]
    assert drawn(5000) == list(range(1000))
    assert drawn(100) == drawn(100) != drawn(100, seed=1)
    assert sum(counts(drawn(42))) == 42
