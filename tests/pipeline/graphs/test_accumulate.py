from pathlib import Path

import numpy as np
import pytest

from pipeline.base import store
from pipeline.camera.geometry import transform
from pipeline.graphs import accumulate
from pipeline.graphs.cloud import Cloud

DRIVE = "2026_01_01_drive_0001"


def step(yaw_rad: float, forward_m: float) -> np.ndarray:
    """T_before_now of a car that goes forward and turns left: the camera's y points down."""
    T = np.eye(4)
    T[:3, :3] = [[np.cos(yaw_rad), 0, -np.sin(yaw_rad)], [0, 1, 0], [np.sin(yaw_rad), 0, np.cos(yaw_rad)]]
    T[2, 3] = forward_m
    return T


def street(frames: int) -> tuple[list[Cloud], dict[int, np.ndarray]]:
    """Clouds of a car that drives a bend: each sees ten points of its own of a street that stands still."""
    rng = np.random.default_rng(0)
    clouds, T_world_now, T_before = [], np.eye(4), {}
    for number in range(frames):
        if number:
            T_before[number] = step(0.05, 1.0)
            T_world_now = T_world_now @ T_before[number]
        world = rng.uniform([-10, -1, 0], [10, 2, 30], (10, 3))
        clouds.append((transform(np.linalg.inv(T_world_now), world).astype(np.float32), np.full(10, number, np.uint8)))
    return clouds, T_before


def held(frames: list[int], T_before: dict[int, np.ndarray], at_most: int) -> list[list[int]]:
    """Return of each frame which frames' points its cloud holds."""
    clouds, _ = street(len(frames))
    made = accumulate.accumulated(frames, clouds, T_before, at_most)
    return [list(dict.fromkeys(cls.tolist())) for _, cls in made]


def test_a_street_that_stands_still_lies_still() -> None:
    clouds, T_before = street(6)
    made = list(accumulate.accumulated(range(6), clouds, T_before, 3))
    T_world_now = np.eye(4)
    for number, (xyz, cls) in enumerate(made):
        T_world_now = T_world_now @ T_before.get(number, np.eye(4))
        T_world_then = np.eye(4)
        for then in range(number + 1):
            T_world_then = T_world_then @ T_before.get(then, np.eye(4))
            here = transform(T_world_now, xyz[cls == then])
            if then > number - 3:
                assert here == pytest.approx(transform(T_world_then, clouds[then][0]), abs=1e-4)
            else:
                assert not len(here)
        assert xyz.dtype == np.float32
        assert (xyz[-10:] == clouds[number][0]).all()  # its own points are where they were
    assert made[-1][0][:, 2].min() < made[0][0][:, 2].min()  # what was passed lies behind


def test_what_lies_before_a_gap_or_unmeasured_motion_is_left_out() -> None:
    _, T_before = street(20)
    assert held([0, 1, 2, 3], T_before, 3) == [[0], [0, 1], [0, 1, 2], [1, 2, 3]]
    assert held([0, 1, 5, 6], T_before, 4) == [[0], [0, 1], [2], [2, 3]]  # by position; frame numbers have the gap
    del T_before[2]
    assert held([0, 1, 2, 3], T_before, 4) == [[0], [0, 1], [2], [2, 3]]
    assert held([3, 4], {}, 2) == [[0], [1]]
    assert held([], T_before, 2) == []


def test_pseudo_clouds_have_the_scale_of_their_depth_and_scans_are_in_metres(tmp_path: Path) -> None:
    T = np.stack([np.eye(4), step(0.1, 2.0), step(0.1, 3.0)]).astype(np.float32)
    for kind, source, forward_m in (
        ("visual", "clouds/pseudo", 1.6), ("visual", "clouds/lidar", 2.0), ("lidar", "clouds/lidar", 2.0)
    ):  # fmt: skip
        path = tmp_path / f"{kind}.h5"
        with store.DriveWriter(path, stage="motion", drive=DRIVE, params={}) as file:
            file.put("frame", np.array([4, 5, 6], np.int32))
            file.put("time_s", np.arange(3) / 10)
            file.put("valid", np.array([0, 1, 0], np.uint8))
            file.put("T_before", T)
            if kind == "visual":
                file.put("scale", np.array([0, 1.25, 0], np.float32))
        with store.DriveReader(path, stage="motion") as motion:
            ((number, T_before),) = accumulate.steps(motion, source).items()
        assert number == 5
        assert T_before == pytest.approx(step(0.1, forward_m), abs=1e-6)
