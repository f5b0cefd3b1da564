"""Paths that start again from the true one, and how far off they end."""

import numpy as np
import pytest

from pipeline.report.judge.paths import Track, drift, segments

STEPS = 101  # 10 m/s for 10 s
TIME_S = np.arange(STEPS) / 10


def track(steering_rad: float | np.ndarray, *onsets: int) -> Track:
    angles = np.broadcast_to(np.asarray(steering_rad, float), STEPS)
    return Track(TIME_S, np.full(STEPS, 10.0), angles, np.array(onsets, int), wheelbase_m=2.7)


def test_a_path_starts_where_the_car_was_and_as_it_stood() -> None:
    bend = track(0.1)
    whole = bend.path(bend.steering_rad, 0, STEPS)
    np.testing.assert_allclose(bend.path(bend.steering_rad, 40, 70), whole[40:70], atol=1e-9)
    # A circle of radius L / tan Θ, to the left.
    radius = 2.7 / np.tan(0.1)
    np.testing.assert_allclose(np.hypot(whole[:, 0], whole[:, 1] - radius), radius, rtol=1e-3)
    straight = bend.path(np.zeros(STEPS), 40, 70)
    ahead = np.diff(straight, axis=0)
    assert np.allclose(ahead, ahead[0])
    turned = 40 * np.tan(0.1) / 2.7
    np.testing.assert_allclose(ahead[0], [np.cos(turned), np.sin(turned)], atol=1e-9)


def test_segments_end_where_the_driver_decides_and_where_nothing_is_predicted() -> None:
    predicted = np.zeros(STEPS)
    predicted[:7] = predicted[50] = predicted[99] = np.nan
    assert segments(track(0.0, 3, 20, 50, 70), predicted) == [(7, 20), (20, 50), (51, 70), (70, 99)]
    assert segments(track(0.0), np.full(STEPS, np.nan)) == []


def test_drift_is_the_distance_at_the_end_for_each_100_m() -> None:
    right, wrong = np.zeros(STEPS), np.full(STEPS, 0.01)
    assert drift([(track(0.0), right)]) == 0
    # Small angle ε from L: after s metres off by ε s² / 2 L; 100 m in one piece, or in two of 50 and 49 steps.
    assert drift([(track(0.0), wrong)]) == pytest.approx(0.01 * 100**2 / 2 / 2.7, rel=0.02)
    halves = drift([(track(0.0, 50), wrong)])
    assert halves == pytest.approx(0.01 * (49**2 + 50**2) / 2 / 2.7 / 99 * 100, rel=0.02)
    assert drift([(track(0.0), np.full(STEPS, np.nan))]) is None
