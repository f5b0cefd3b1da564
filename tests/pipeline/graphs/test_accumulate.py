from pathlib import Path

import numpy as np
import pytest

from pipeline.base import store
from pipeline.camera.geometry import transform
from pipeline.graphs.accumulate import Accumulator, read_steps
from pipeline.graphs.cloud import Cloud


def step(yaw_rad: float, forward_m: float) -> np.ndarray:
    """Return T_before_now of a car that drives forward and turns left; the camera's y points down."""
    T = np.eye(4)
    T[:3, :3] = [[np.cos(yaw_rad), 0, -np.sin(yaw_rad)], [0, 1, 0], [np.sin(yaw_rad), 0, np.cos(yaw_rad)]]
    T[2, 3] = forward_m
    return T


def street(frames: int) -> tuple[list[Cloud], list[np.ndarray]]:
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
        for number, cloud in zip(numbers, street(len(numbers))[0], strict=True)
    ]


def test_static_points_coincide() -> None:
    clouds, poses = street(6)
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
