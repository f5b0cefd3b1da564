from typing import get_args

import numpy as np
import pytest

from pipeline.camera import classes
from pipeline.camera.geometry import rays
from pipeline.perception.depth_scale import MODES, Frame, from_camera_height, median_ratio
from pipeline.sections.perception import DepthScale

SIZE = (48, 96)
K = np.array([[60.0, 0, 47], [0, 60, 20], [0, 0, 1]])


@pytest.mark.parametrize("pitch_rad", [0.0, 0.03, -0.05])
@pytest.mark.parametrize("unit", [1.0, 0.2, 17.0])
def test_the_road_tells_the_scale_whatever_the_pitch(pitch_rad: float, unit: float) -> None:
    normal = np.array([0, np.cos(pitch_rad), np.sin(pitch_rad)])
    along = rays(K, SIZE) @ normal
    depth = np.where(along > 0.02, 1.65 / np.maximum(along, 0.02), 0) * unit
    cls = np.where(depth > 0, classes.ROAD, classes.SKY)
    noise = np.random.default_rng(0).random(SIZE)
    depth[noise < 0.02] *= 0.97  # a few stones
    assert from_camera_height(depth, cls, K, 1.65) == pytest.approx(1 / unit, rel=0.02)


def test_too_little_road_tells_nothing() -> None:
    assert from_camera_height(np.ones(SIZE), np.full(SIZE, classes.CAR), K, 1.65) is None


def test_medians_of_truth_and_depth_tell_the_scale() -> None:
    truth = np.random.default_rng(0).uniform(1, 80, SIZE)
    truth[::2] = 0
    assert median_ratio(truth / 3, truth) == pytest.approx(3)
    assert median_ratio(truth, np.zeros(SIZE)) is None


def test_the_params_know_each_mode() -> None:
    assert list(MODES) == list(get_args(DepthScale))


def road() -> tuple[np.ndarray, np.ndarray]:
    """Return depth [H,W] in metres of a road 1.65 m below the camera, and its trainIds."""
    y = rays(K, SIZE)[..., 1]
    depth_m = np.where(y > 0.02, 1.65 / np.maximum(y, 0.02), 0)
    return depth_m, np.where(depth_m > 0, classes.ROAD, classes.SKY)


@pytest.mark.parametrize(("mode", "factor"), [("metric", 1), ("camera_height", 5), ("lidar_median", 5), ("none", 1)])
def test_each_mode_rescales_in_place(mode: str, factor: float) -> None:
    depth_m, cls = road()
    depth = (depth_m / 5).astype(np.float32)
    assert MODES[mode].rescale(Frame(depth, cls, depth_m, K, 1.65), 0.0) == pytest.approx(factor, rel=1e-4)
    np.testing.assert_allclose(depth, depth_m / 5 * factor, rtol=1e-4)


@pytest.mark.parametrize("mode", ["camera_height", "lidar_median"])
def test_a_frame_that_does_not_tell_takes_the_factor_before(mode: str) -> None:
    depth = np.ones(SIZE, np.float32)
    assert MODES[mode].rescale(Frame(depth, np.full(SIZE, classes.CAR), None, K, 1.65), 3.0) == 3.0
    assert (depth == 3).all()
    assert MODES[mode].rescale(Frame(depth, np.full(SIZE, classes.CAR), None, K, 1.65), 0.0) == 0.0
    assert not depth.any()  # none so far: no depth, not a wrong one


def test_depth_of_an_unknown_unit_alone_is_scaled_to_be_scored() -> None:
    truth = np.random.default_rng(0).uniform(1, 80, SIZE)
    assert {mode: scale.scoring_factor(truth / 3, truth) for mode, scale in MODES.items() if mode != "none"} == {
        "metric": 1.0, "camera_height": 1.0, "lidar_median": 1.0,
    }  # fmt: skip
    assert MODES["none"].scoring_factor(truth / 3, truth) == pytest.approx(3)
    assert "unknown unit" in MODES["none"].unit
    assert {scale.unit for mode, scale in MODES.items() if mode != "none"} == {"1/256 m"}
