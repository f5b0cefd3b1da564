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
