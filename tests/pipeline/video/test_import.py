"""Packets of a log are consistent: position, heading and velocities; the parts of a split."""

from itertools import pairwise

import numpy as np
import pytest

from pipeline.base.errors import InputError
from pipeline.kitti.oxts import COLUMNS, EARTH_RADIUS_M, VF, WU, YAW
from pipeline.video import drive_layout as layout
from pipeline.video.import_recording import cut
from pipeline.video.log import MotionLog

DRIVE = "2027_03_31_drive_0001"
SAMPLES_S = np.arange(0, 20, 0.01)
IMAGES_S = np.sort(np.random.default_rng(0).uniform(1, 19, 170))
LAT, LON, VN, VE, WZ = (COLUMNS.index(name) for name in ("lat", "lon", "vn", "ve", "wz"))


@pytest.fixture(scope="module")
def rows() -> np.ndarray:
    speed, yaw_rate = 8 + 3 * np.sin(SAMPLES_S / 3), 0.3 * np.sin(SAMPLES_S / 2)
    return layout.packets(MotionLog(SAMPLES_S, speed, yaw_rate), IMAGES_S)


def test_rates_at_the_cameras_times(rows: np.ndarray) -> None:
    np.testing.assert_allclose(rows[:, VF], 8 + 3 * np.sin(IMAGES_S / 3), atol=1e-4)
    np.testing.assert_allclose(rows[:, WU], 0.3 * np.sin(IMAGES_S / 2), atol=1e-5)
    np.testing.assert_array_equal(rows[:, WZ], rows[:, WU])


def test_heading_is_the_integral_of_the_yaw_rate(rows: np.ndarray) -> None:
    expected = 0.6 * (np.cos(IMAGES_S[0] / 2) - np.cos(IMAGES_S / 2))
    np.testing.assert_allclose(np.unwrap(rows[:, YAW]), expected, atol=1e-5)
    np.testing.assert_allclose(np.arctan2(rows[:, VN], rows[:, VE]), rows[:, YAW], atol=1e-12)
    np.testing.assert_allclose(np.hypot(rows[:, VN], rows[:, VE]), rows[:, VF])


def test_position_is_the_integral_of_velocity(rows: np.ndarray) -> None:
    fine = np.linspace(IMAGES_S[0], 20, 200_001)
    heading = 0.6 * (np.cos(IMAGES_S[0] / 2) - np.cos(fine / 2))
    velocity = (8 + 3 * np.sin(fine / 3))[:, None] * np.stack([np.cos(heading), np.sin(heading)], axis=-1)
    track = np.cumsum(velocity, axis=0) * (fine[1] - fine[0])
    expected = np.column_stack([np.interp(IMAGES_S, fine, axis) for axis in track.T])
    places = np.deg2rad(rows[:, [LON, LAT]]) * EARTH_RADIUS_M
    np.testing.assert_allclose(places, expected, atol=0.01)


def test_parts_have_their_share_of_the_time_and_a_gap_between_them() -> None:
    time_s = np.arange(200) / 10
    parts = cut(time_s > 1, time_s, (60, 20, 20))
    assert [part.sum() for part in parts] == pytest.approx([(0.6 * 18.9 - 2) * 10, (0.2 * 18.9 - 2) * 10, 37.8], abs=2)
    for before, after in pairwise(parts):
        assert time_s[after].min() - time_s[before].max() >= 2
    with pytest.raises(InputError, match="--split"):
        cut(time_s > 1, time_s, (98, 1, 1))
