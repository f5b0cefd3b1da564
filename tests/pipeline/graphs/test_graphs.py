"""Clouds, their sampling and accumulation, kNN graphs, and the neighbourhoods of PointNet++."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from pipeline.base import store
from pipeline.base.errors import InputError
from pipeline.camera import classes, geometry
from pipeline.camera.geometry import transform
from pipeline.graphs import cloud, graph, neighbourhoods
from pipeline.graphs.cloud import Cloud
from pipeline.graphs.frame_graph import Accumulator, read_steps

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
    xyz, labels = cloud.pseudo_cloud(depth, np.full((20, 40), classes.VOID, np.uint8), K, max_depth_m=80.0)
    assert len(xyz) == 20 * 40 - 2  # without classes, each pixel with depth is a point


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


def step(yaw_rad: float, forward_m: float) -> np.ndarray:
    """Return T_before_now of a car that drives forward and turns left; the camera's y points down."""
    T = np.eye(4)
    T[:3, :3] = [[np.cos(yaw_rad), 0, -np.sin(yaw_rad)], [0, 1, 0], [np.sin(yaw_rad), 0, np.cos(yaw_rad)]]
    T[2, 3] = forward_m
    return T


def moving_clouds(frames: int) -> tuple[list[Cloud], list[np.ndarray]]:
    """Return clouds of ten static points each, which carry the frame as class, and T_world_now of each frame."""
    rng = np.random.default_rng(0)
    clouds, poses = [], [np.eye(4)]
    for number in range(frames):
        world = rng.uniform([-10, -1, 0], [10, 2, 30], (10, 3))
        clouds.append((transform(np.linalg.inv(poses[-1]), world).astype(np.float32), np.full(10, number, np.uint8)))
        poses.append(poses[-1] @ step(0.05, 1.0))
    return clouds, poses


def combined(numbers: list[int], measured: set[int], frames: int) -> list[Cloud]:
    accumulator = Accumulator(frames)
    return [
        accumulator.add(number, cloud, step(0.05, 1.0) if number in measured else None)
        for number, cloud in zip(numbers, moving_clouds(len(numbers))[0], strict=True)
    ]


def test_static_points_coincide() -> None:
    clouds, poses = moving_clouds(6)
    for number, (xyz, cls) in enumerate(combined(list(range(6)), set(range(1, 6)), 3)):
        assert xyz.dtype == np.float32
        assert set(cls.tolist()) == set(range(max(0, number - 2), number + 1))
        for then in set(cls.tolist()):
            world = transform(poses[number], xyz[cls == then])
            assert world == pytest.approx(transform(poses[then], clouds[then][0]), abs=1e-4)
        assert (xyz[-10:] == clouds[number][0]).all()


@pytest.mark.parametrize(
    ("numbers", "measured", "expected"),
    [
        ([0, 1, 2, 3], {1, 2, 3}, [[0], [0, 1], [0, 1, 2], [1, 2, 3]]),
        ([0, 1, 5, 6], {1, 5, 6}, [[0], [0, 1], [2], [2, 3]]),  # a gap
        ([0, 1, 2, 3], {1, 3}, [[0], [0, 1], [2], [2, 3]]),  # unmeasured motion
        ([3, 4], set(), [[0], [1]]),
    ],
)
def test_a_gap_or_unmeasured_motion_starts_anew(
    numbers: list[int], measured: set[int], expected: list[list[int]]
) -> None:
    assert [list(dict.fromkeys(cls.tolist())) for _, cls in combined(numbers, measured, 3)] == expected


@pytest.mark.parametrize(("source", "forward_m"), [("clouds/pseudo", 1.6), ("clouds/lidar", 2.0)])
def test_steps_have_the_length_unit_of_the_clouds(tmp_path: Path, source: str, forward_m: float) -> None:
    with store.DriveWriter(tmp_path / "a.h5", stage="motion", drive="drive", params={}) as file:
        file.put("frame", np.array([4, 5, 6], np.int32))
        file.put("valid", np.array([0, 1, 0], np.uint8))
        file.put("T_before", np.stack([np.eye(4), step(0.1, 2.0), step(0.1, 3.0)]).astype(np.float32))
        file.put("scale", np.array([0, 1.25, 0], np.float32))
    with store.DriveReader(tmp_path / "a.h5", stage="motion") as motion:
        ((number, T_before),) = read_steps(motion, source).items()
    assert number == 5
    assert T_before == pytest.approx(step(0.1, forward_m), abs=1e-6)


def street(points: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    xyz = (rng.normal(size=(points, 3)) * [10, 2, 30]).astype(np.float32)
    return xyz, rng.integers(0, 4, points).astype(np.uint8)


def pairs(made: graph.Graph) -> set[tuple[int, int]]:
    rows = np.repeat(np.arange(len(made.degree)), made.degree)
    return set(zip(rows.tolist(), made.indices.tolist(), strict=True))


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 120), st.integers(0, 8), st.sampled_from([0.0, 0.2, 1.0]), st.integers(0, 2**16))
def test_a_graph_is_the_symmetric_knn_graph_pruned_between_classes(points: int, k: int, keep: float, seed: int) -> None:
    """Paper Fig. 3: directed edges are counted, 600 for 100 points."""
    xyz, cls = street(points, seed)
    made = graph.build(xyz, cls, k, keep, np.random.default_rng(seed))
    near = range(2, min(k, points - 1) + 2)
    neighbours = cKDTree(xyz).query(xyz, near)[1] if points > 1 and k else np.empty((points, 0), int)
    directed = {(i, int(j)) for i, row in enumerate(neighbours) for j in row}
    whole = directed | {(j, i) for i, j in directed}
    within = {(i, j) for i, j in whole if cls[i] == cls[j]}
    kept = pairs(made)
    assert within <= kept <= whole
    assert {(j, i) for i, j in kept} == kept
    assert len(kept - within) == 2 * round(keep * len(whole - within) / 2)
    assert (made.edges_knn, made.edges_kept) == (len(directed), len(directed & kept))
    rows = np.split(made.indices.astype(int), np.cumsum(made.degree)[:-1])
    assert all((np.diff(row) > 0).all() for row in rows)  # ascending, and each neighbour once


def test_a_hub_of_more_than_255_neighbours_is_refused() -> None:
    def hub(others: int) -> graph.Graph:
        named = np.zeros((others + 1, 1), np.int32)
        named[0] = 1
        return graph.prune(graph.undirected(named), np.zeros(others + 1, np.uint8), 1.0, np.random.default_rng(0))

    assert hub(255).degree[0] == 255
    with pytest.raises(InputError, match="256 neighbours"):
        hub(256)


@pytest.fixture
def xyz() -> np.ndarray:
    """A street's width of points as clouds store them, some of them twice."""
    rng = np.random.default_rng(0)
    points = cloud.quantise(rng.uniform([-10, -1, 0], [10, 2, 40], (240, 3)))
    return points[np.sort(rng.integers(0, 240, 300))]


def squared(a: np.ndarray, b: np.ndarray) -> float:
    """In integers of 1/1024 m, so that nothing is rounded."""
    return sum((round(float(p) * 1024) - round(float(q) * 1024)) ** 2 for p, q in zip(a, b, strict=True)) / 1024**2


def reference_fps(xyz: np.ndarray, count: int) -> list[int]:
    chosen = [0]
    while len(chosen) < min(count, len(xyz)):
        best, farthest = 0, -1.0
        for point in range(len(xyz)):
            nearest = min(squared(xyz[point], xyz[other]) for other in chosen)
            if nearest > farthest:
                best, farthest = point, nearest
        chosen.append(best)
    return chosen


def reference_ball(xyz: np.ndarray, centre: int, radius_m: float, count: int, order: np.ndarray) -> list[int]:
    found = [int(point) for point in order if squared(xyz[point], xyz[centre]) <= radius_m**2][:count]
    return found + [found[0]] * (count - len(found))


def test_farthest_points_are_those_of_brute_force(xyz: np.ndarray) -> None:
    assert neighbourhoods.farthest_points(xyz, 24).tolist() == reference_fps(xyz, 24)
    # Fewer choices are the beginning of more.
    assert neighbourhoods.farthest_points(xyz, 5).tolist() == reference_fps(xyz, 24)[:5]


@pytest.mark.parametrize("radius_m", [0.5, 3.0, 8.0, 100.0])
def test_balls_are_those_of_brute_force(xyz: np.ndarray, radius_m: float) -> None:
    centres = neighbourhoods.farthest_points(xyz, 20)
    for order in (None, np.random.default_rng(1).permutation(len(xyz))):
        found = neighbourhoods.ball_query(xyz, centres, radius_m, 12, order)
        expected = np.arange(len(xyz)) if order is None else order
        assert found.tolist() == [reference_ball(xyz, int(centre), radius_m, 12, expected) for centre in centres]


def test_levels_build_on_each_other(xyz: np.ndarray) -> None:
    (first, _), (second, neighbours) = neighbourhoods.levels(
        xyz, [(40, 5.0, 8), (10, 12.0, 6)], np.random.default_rng(0)
    )
    centres = xyz[first]
    assert second.tolist() == reference_fps(centres, 10)
    order = np.arange(40)
    assert neighbours.tolist() == [reference_ball(centres, int(c), 12.0, 6, order) for c in second]
