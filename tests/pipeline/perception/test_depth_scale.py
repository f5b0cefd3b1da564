import numpy as np
import pytest

from pipeline.camera import classes
from pipeline.camera.geometry import rays
from pipeline.perception.depth_scale import from_camera_height, from_truth

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
    assert from_truth(truth / 3, truth) == pytest.approx(3)
    assert from_truth(truth, np.zeros(SIZE)) is None
