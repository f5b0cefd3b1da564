"""The fit of the steering wheel's angle to measured motion, and the table."""

import numpy as np
import pytest

from benchmarks import udacity

TIME_S = np.arange(600) / 10
MEASURED = 0.2 * np.sin(TIME_S / 3)


def test_the_three_constants_are_found() -> None:
    wheel = udacity.Wheel(gain=42.0, offset_rad=0.02, lag_s=0.1)
    true_rad = wheel.angle(TIME_S, MEASURED)
    found = udacity.fit(TIME_S, MEASURED, true_rad)
    assert found == pytest.approx(wheel, rel=1e-3, abs=1e-3)
    assert found.angle(TIME_S, MEASURED) == pytest.approx(true_rad, abs=1e-6)


def test_the_lag_is_the_delay_of_the_motion_behind_the_wheel() -> None:
    earlier = np.interp(TIME_S + 0.2, TIME_S, MEASURED)  # a wheel that leads by two frames
    assert udacity.fit(TIME_S, MEASURED, 2 * earlier).lag_s == pytest.approx(0.2, abs=0.03)


def test_rows_are_sorted_by_their_error() -> None:
    wheel_rad = np.array([0.3, -0.4])
    table = udacity.table({"best": wheel_rad + 0.01, "zero": np.zeros(2), "worse": wheel_rad * 0.5}, wheel_rad)
    assert [line.split("|")[1].strip() for line in table.splitlines()[2:]] == ["zero", "worse", "best"]
    assert "| zero | 0.3536 |" in table
