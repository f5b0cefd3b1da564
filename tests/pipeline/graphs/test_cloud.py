from pathlib import Path

import numpy as np
import pytest

from pipeline.base.store import DriveReader, DriveWriter
from pipeline.camera import classes, geometry
from pipeline.graphs import cloud

K = np.array([[100.0, 0, 19.5], [0, 100.0, 9.5], [0, 0, 1]])


def test_pseudo_cloud_keeps_what_is_seen_and_solid() -> None:
    depth = np.full((20, 40), 10.0)
    cls = np.full((20, 40), classes.ROAD, np.uint8)
    depth[0, 0], depth[1, 1] = 0.0, 81.0
    cls[2, 2], cls[3, 3] = classes.SKY, classes.VOID
    xyz, labels = cloud.pseudo_cloud(depth, cls, K, max_depth_m=80.0)
    assert len(xyz) == len(labels) == 20 * 40 - 4
    assert (labels == classes.ROAD).all()
    uv, z = geometry.project(xyz.astype(np.float64), K)
    assert z == pytest.approx(np.full(len(z), 10.0))
    seen = set(map(tuple, np.rint(uv).astype(int).tolist()))
    assert seen == {(u, v) for u in range(40) for v in range(20)} - {(0, 0), (1, 1), (2, 2), (3, 3)}


def test_pseudo_cloud_of_a_ground_plane_is_flat() -> None:
    v = np.arange(11, 20)
    depth = np.zeros((20, 40))
    depth[11:] = (100.0 * 1.65 / (v - 9.5))[:, None]
    xyz, _ = cloud.pseudo_cloud(depth, np.zeros((20, 40), np.uint8), K, max_depth_m=200.0)
    assert len(xyz) == 9 * 40
    assert xyz[:, 1] == pytest.approx(1.65, abs=1e-5)


def test_lidar_points_take_the_class_under_them() -> None:
    T_cam_velo = np.array([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])
    cls = np.full((20, 40), classes.CAR, np.uint8)
    cls[:, 20:] = classes.SKY
    scan = np.array([[10.0, 1, 0, 0.5], [10, -1, 0, 0.5], [-10, 0, 0, 0.5], [10, 50, 0, 0.5]], np.float32)
    xyz, labels = cloud.lidar_cloud(scan, T_cam_velo, K, cls)
    assert xyz == pytest.approx(np.array([[-1, 0, 10], [1, 0, 10], [0, 0, -10], [-50, 0, 10]]))
    # left of the centre a car, right of it sky (no laser returns from there), behind and beside the image nothing
    assert labels.tolist() == [classes.CAR, classes.VOID, classes.VOID, classes.VOID]
    assert (cloud.lidar_cloud(scan, T_cam_velo, K, None)[1] == classes.VOID).all()


def test_sample_is_a_sorted_subset_and_depends_on_the_frame_alone() -> None:
    chosen = cloud.sample(1000, 100, cloud.frame_rng(0, "2011_09_26_drive_0001", 5))
    assert len(set(chosen.tolist())) == 100
    assert (np.diff(chosen) > 0).all()
    again = cloud.sample(1000, 100, cloud.frame_rng(0, "2011_09_26_drive_0001", 5))
    other = cloud.sample(1000, 100, cloud.frame_rng(0, "2011_09_26_drive_0001", 6))
    assert (chosen == again).all()
    assert (chosen != other).any()
    assert cloud.sample(3, 100, cloud.frame_rng(0, "", 0)).tolist() == [0, 1, 2]


def test_morton_order_equals_interleaving_bit_by_bit() -> None:
    xyz = cloud.quantise(np.random.default_rng(0).uniform(-60, 60, (200, 3)))

    def code(point: np.ndarray) -> int:
        cells = [int(np.floor(value * 1024)) + 2**20 for value in point]
        return sum(((cells[axis] >> bit) & 1) << (3 * bit + axis) for bit in range(21) for axis in range(3))

    order = cloud.morton_order(xyz)
    assert sorted(order.tolist()) == list(range(200))
    codes = [code(point) for point in xyz[order]]
    assert codes == sorted(codes)


def test_quantise_is_exact_and_near() -> None:
    xyz = np.random.default_rng(0).uniform(-200, 200, (1000, 3)).astype(np.float32)
    coarse = cloud.quantise(xyz)
    assert np.abs(coarse - xyz).max() <= 0.5 / 1024 + 2e-5
    assert (cloud.quantise(coarse) == coarse).all()


def _cloud(points: int, seed: int = 0) -> cloud.Cloud:
    rng = np.random.default_rng(seed)
    return rng.uniform(-20, 20, (points, 3)).astype(np.float32), rng.integers(0, 19, points, np.uint8)


def test_a_stored_cloud_is_a_part_of_the_whole_in_order() -> None:
    xyz, cls = _cloud(300)
    made, labels = cloud.stored((xyz, cls), 100, cloud.frame_rng(0, "drive", 0))
    assert len(made) == len(labels) == 100
    assert (cloud.morton_order(made) == np.arange(100)).all()
    whole = {tuple(point): number for point, number in zip(cloud.quantise(xyz).tolist(), cls.tolist(), strict=True)}
    assert [whole[tuple(point)] for point in made.tolist()] == labels.tolist()


def test_chosen_points_lie_in_the_crop_and_keep_their_order_and_class() -> None:
    xyz, cls = _cloud(300)
    cls[:] = np.arange(300) % 19
    made, labels = cloud.chosen_points((xyz, cls), (-5, 0, 5, 20), 20, cloud.frame_rng(0, "drive", 0))
    assert len(made) == 20
    assert (np.abs(made[:, 0]) <= 5).all()
    assert (made[:, 2] >= 0).all()
    rows = [int(np.flatnonzero((xyz == point).all(axis=1))[0]) for point in made]
    assert rows == sorted(rows)
    assert labels.tolist() == cls[rows].tolist()


def test_a_written_file_holds_the_clouds_frame_by_frame(tmp_path: Path) -> None:
    clouds = [_cloud(5), _cloud(0), _cloud(3, seed=1)]
    with DriveWriter(tmp_path / "a.h5", stage="clouds", drive="drive", params={}) as writer:
        counts = cloud.write(writer, np.array([2, 3, 7]), np.array([0, 0.1, 0.5]), clouds)
    assert counts == {"frames": 3, "points": 8}
    with DriveReader(tmp_path / "a.h5", stage="clouds") as file:
        assert file["ptr"].tolist() == [0, 5, 5, 8]
        np.testing.assert_array_equal(file["xyz"], np.concatenate([xyz for xyz, _ in clouds]))
        np.testing.assert_array_equal(file["cls"], np.concatenate([cls for _, cls in clouds]))
        assert (file.frame.tolist(), file.frame.dtype) == ([2, 3, 7], np.int32)
