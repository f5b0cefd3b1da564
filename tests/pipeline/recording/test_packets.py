"""Packets from speed and yaw rate are consistent: position, heading and velocities are one motion."""

import numpy as np
import pytest

from pipeline.kitti.oxts import COLUMNS, EARTH_RADIUS_M, VF, WU, YAW
from pipeline.recording.packets import packets
from pipeline.recording.track import Rates

SAMPLES_S = np.arange(0, 20, 0.01)
IMAGES_S = np.sort(np.random.default_rng(0).uniform(1, 19, 170))
LAT, LON, VN, VE, AL, WZ = (COLUMNS.index(name) for name in ("lat", "lon", "vn", "ve", "al", "wz"))


@pytest.fixture(scope="module")
def rows() -> np.ndarray:
    speed, yaw_rate = 8 + 3 * np.sin(SAMPLES_S / 3), 0.3 * np.sin(SAMPLES_S / 2)
    rates = Rates(SAMPLES_S, speed, yaw_rate, latitude_deg=49.0, longitude_deg=8.4, heading_rad=2.0)
    return packets(rates, IMAGES_S)


def test_rates_at_the_cameras_times(rows: np.ndarray) -> None:
    np.testing.assert_allclose(rows[:, VF], 8 + 3 * np.sin(IMAGES_S / 3), atol=1e-4)
    np.testing.assert_allclose(rows[:, WU], 0.3 * np.sin(IMAGES_S / 2), atol=1e-5)
    np.testing.assert_array_equal(rows[:, WZ], rows[:, WU])


def test_heading_is_the_integral_of_the_yaw_rate(rows: np.ndarray) -> None:
    expected = 2.0 + 0.6 * (1 - np.cos(IMAGES_S / 2))
    np.testing.assert_allclose(np.unwrap(rows[:, YAW]), expected, atol=1e-5)
    np.testing.assert_allclose(np.arctan2(rows[:, VN], rows[:, VE]), rows[:, YAW], atol=1e-12)
    np.testing.assert_allclose(np.hypot(rows[:, VN], rows[:, VE]), rows[:, VF])


def test_position_is_the_integral_of_velocity(rows: np.ndarray) -> None:
    fine = np.linspace(0, 20, 200_001)
    heading = 2.0 + 0.6 * (1 - np.cos(fine / 2))
    steps = (8 + 3 * np.sin(fine / 3))[:, None] * np.stack([np.cos(heading), np.sin(heading)], axis=-1) * 1e-4
    track = np.cumsum(steps, axis=0)
    expected = np.column_stack([np.interp(IMAGES_S, fine, axis) for axis in track.T])
    north = np.deg2rad(rows[:, LAT] - 49.0) * EARTH_RADIUS_M
    east = np.deg2rad(rows[:, LON] - 8.4) * EARTH_RADIUS_M * np.cos(np.deg2rad(49))
    np.testing.assert_allclose(np.column_stack([east, north]), expected, atol=0.01)
