"""The fit of the steering wheel's angle to measured motion, and the table."""

import numpy as np
import pytest

from benchmarks import udacity


def motion() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    time_s = np.arange(600) / 10
    return time_s, 0.2 * np.sin(time_s / 3), 15 + 4 * np.sin(time_s / 7)


def test_the_four_constants_are_found() -> None:
    wheel = udacity.Wheel(gain=42.0, understeer=0.003, offset_rad=0.02, lag_s=0.1)
    true_rad = wheel.angle(*motion())
    found = udacity.fit(*motion(), true_rad)
    assert found == pytest.approx(wheel, rel=1e-3, abs=1e-3)
    assert found.angle(*motion()) == pytest.approx(true_rad, abs=1e-6)


def test_the_lag_is_the_delay_of_the_motion_behind_the_wheel() -> None:
    time_s, yaw_rate_radps, speed_mps = motion()
    earlier = np.interp(time_s + 0.2, time_s, yaw_rate_radps)  # a wheel that leads by two frames
    assert udacity.fit(time_s, yaw_rate_radps, speed_mps, 2 * earlier).lag_s == pytest.approx(0.2, abs=0.03)


def test_rows_are_sorted_by_their_error() -> None:
    wheel_rad = np.array([0.3, -0.4])
    table = udacity.table({"best": wheel_rad + 0.01, "zero": np.zeros(2), "worse": wheel_rad * 0.5}, wheel_rad)
    assert [line.split("|")[1].strip() for line in table.splitlines()[2:]] == ["zero", "worse", "best"]
    assert "| zero | 0.3536 |" in table
