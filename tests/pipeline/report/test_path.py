"""Places of a path, and the tracks of the wheels in an image."""

import numpy as np
import pytest

from pipeline.camera.camera import Camera
from pipeline.report.path import HALF_TRACK_M, STEP_M, follow, path_steps, wheel_tracks

CAMERA = Camera(np.array([[100.0, 0, 160], [0, 100, 40], [0, 0, 1]]), (96, 320), 1.5)


def test_a_path_of_ranges_ends_where_its_arcs_do() -> None:
    """5 m straight on, then a quarter of a circle of 10 m to the left."""
    steps = path_steps([0.0, 0.1], [0, 5, 5 + 5 * np.pi], 0.01)
    places, heading_rad = follow(steps, 0.01)
    assert places[500] == pytest.approx(5.0)
    assert places[-1] == pytest.approx(15 + 10j, abs=0.02)
    assert heading_rad[-1] == pytest.approx(np.pi / 2, abs=2e-3)


def test_the_wheels_on_a_straight_road_meet_at_the_horizon() -> None:
    left, right = wheel_tracks(np.zeros(200), CAMERA)
    distance_m = STEP_M * np.arange(3, 201)  # nearer steps are not drawn
    np.testing.assert_allclose(left[:, 0], 160 - 100 * HALF_TRACK_M / distance_m)
    np.testing.assert_allclose(right[:, 0], 160 + 100 * HALF_TRACK_M / distance_m)
    np.testing.assert_allclose(left[:, 1], 40 + 100 * 1.5 / distance_m)
    uphill, _ = wheel_tracks(np.zeros(200), CAMERA, slope=-0.1)
    np.testing.assert_allclose(uphill[:, 1], left[:, 1] - 10)


def test_a_bend_to_the_left_is_on_the_left_and_ends_where_it_turns_back() -> None:
    left, right = wheel_tracks(np.full(200, 0.1), CAMERA)  # circles of radius 10 m
    assert left[-1, 0] < right[-1, 0] < 160
    assert len(left) < len(right) < 100
