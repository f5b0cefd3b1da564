"""Speed and yaw rate of a track equal those of the curve it samples."""

from pathlib import Path

import numpy as np
import pytest

from pipeline.recording.track import Fixes, coverage, rates_of
from tests.gnss import bend

FILE = Path("track.gpx")


def fixes_of(
    count: int, step_s: float, speed_mps: float, yaw_rate_radps: float, measured: bool, noise_m: float = 0
) -> Fixes:
    time_s, places, heading = bend(count, step_s, speed_mps, yaw_rate_radps)
    places = places + np.random.default_rng(0).normal(0, noise_m / 1e5, places.shape)
    velocity = speed_mps * np.stack([np.cos(heading), np.sin(heading)], axis=-1) if measured else None
    return Fixes(time_s, places[:, 0], places[:, 1], velocity)


@pytest.mark.parametrize("measured", [True, False])
@pytest.mark.parametrize("yaw_rate_radps", [0.15, -0.15])
@pytest.mark.parametrize("step_s", [1.0, 0.1])
def test_a_circle(step_s: float, yaw_rate_radps: float, measured: bool) -> None:
    rates = rates_of(fixes_of(40, step_s, 9.0, yaw_rate_radps, measured), FILE)
    inner = slice(3, -3) if step_s == 1 else slice(6, -6)  # at both ends, fits are one-sided
    np.testing.assert_allclose(rates.speed_mps[inner], 9.0, rtol=0.02)
    np.testing.assert_allclose(rates.yaw_rate_radps[inner], yaw_rate_radps, rtol=0.04)
    assert rates.heading_rad == pytest.approx(0.3, abs=0.06)
    assert (rates.latitude_deg, rates.longitude_deg) == (49.0, 8.4)


@pytest.mark.parametrize("measured", [True, False])
def test_yaw_rate_is_zero_at_standstill(measured: bool) -> None:
    fixes = fixes_of(30, 1.0, 0.3, 0.5, measured, noise_m=0.1)
    rates = rates_of(fixes, FILE)
    np.testing.assert_array_equal(rates.yaw_rate_radps, 0)
    assert rates.speed_mps.max() < 1.0


def test_images_between_close_samples_are_usable() -> None:
    times = np.array([-1.0, -0.0005, 0, 0.1, 0.25, 0.7, 1.0, 1.1, 2.0])
    samples = np.array([0, 0.2, 0.4, 1.0, 1.1])
    usable, counts = coverage(samples, times, max_gap_s=0.5)
    assert usable.tolist() == [False, True, True, True, True, False, True, True, False]
    # 3 interpolated, including the one within a rounding error of the first sample
    left_out = {"before": 1, "after": 1, "in_gaps": 1}
    assert counts == {"interpolated": 3, "largest_gap_s": pytest.approx(0.2), "left_out": left_out}
    _, counts = coverage(samples, times, max_gap_s=0.61)
    assert counts == {"interpolated": 4, "largest_gap_s": pytest.approx(0.6), "left_out": left_out | {"in_gaps": 0}}
    usable, counts = coverage(np.array([0.0, 10]), np.array([4.0, 5.0]), max_gap_s=2)
    assert (usable.any(), counts["left_out"]["in_gaps"], counts["largest_gap_s"]) == (False, 2, 0)
