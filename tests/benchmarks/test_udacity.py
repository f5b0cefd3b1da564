"""The fit of the steering wheel's angle to measured motion."""

import numpy as np
import pytest

from benchmarks import udacity

TIME_S = np.arange(600) / 10
MEASURED = 0.2 * np.sin(TIME_S / 3)


def test_gain_offset_and_lag_are_found():
    wheel = udacity.Wheel(gain=42.0, offset_rad=0.02, lag_s=0.1)  # the wheel leads by a frame
    found = udacity.fit(TIME_S, MEASURED, wheel.angle(TIME_S, MEASURED))
    assert found == pytest.approx(wheel, rel=1e-3, abs=1e-3)


def test_rows_are_sorted_by_their_error():
    wheel_rad = np.array([0.3, -0.4])
    rmse = udacity.errors({"best": wheel_rad + 0.01, "zero": np.zeros(2), "worse": wheel_rad * 0.5}, wheel_rad)
    assert [*rmse] == ["zero", "worse", "best"]
    assert rmse["zero"] == pytest.approx(0.125**0.5)
