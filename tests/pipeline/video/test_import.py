"""The written folder is what stage ingest reads, and packets are consistent: position, heading and velocities."""

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from pipeline.base.errors import InputError
from pipeline.camera.camera import Camera
from pipeline.camera.images import read_pixels
from pipeline.kitti.oxts import COLUMNS, EARTH_RADIUS_M, VF, WU, YAW, read_row, read_times
from pipeline.kitti.raw import KittiDrive, read_calibration
from pipeline.video import drive_layout as layout
from pipeline.video.import_recording import cut
from pipeline.video.log import MotionLog
from tests.footage import SIZE, pictures

DRIVE = "2027_03_31_drive_0001"
SAMPLES_S = np.arange(0, 20, 0.01)
IMAGES_S = np.sort(np.random.default_rng(0).uniform(1, 19, 170))
LAT, LON, VN, VE, WZ = (COLUMNS.index(name) for name in ("lat", "lon", "vn", "ve", "wz"))
K = np.array([[50.0, 0, 31.5], [0, 50.0, 23.5], [0, 0, 1]])


@pytest.mark.parametrize("threads", [1, 3])
def test_files_are_numbered(tmp_path: Path, threads: int) -> None:
    folder, images, usable = layout.drive_folder(tmp_path, DRIVE, False), pictures(9), np.arange(9) % 4 != 0
    time_s = 1e9 + np.arange(9) * 0.125
    log = MotionLog(time_s, np.arange(9.0) / 7, np.zeros(9))
    layout.write_images(folder, ((int(number), images[number]) for number in np.flatnonzero(usable)), threads)
    layout.write_packets(folder, log, time_s, usable)
    layout.write_times(folder, DRIVE[:10], time_s, ("oxts", "image_02"))
    layout.write_calibration(folder.parent, Camera(K, SIZE))
    layout.write_horizon(folder, 20.5)

    drive, numbers = KittiDrive(folder), [1, 2, 3, 5, 6, 7]
    assert list(drive.images(2)) == list(drive.oxts) == numbers
    np.testing.assert_array_equal([read_pixels(path) for path in drive.images(2).values()], images[numbers])
    rows = [read_row(path) for path in drive.oxts.values()]
    np.testing.assert_allclose(rows, layout.packets(log, time_s[usable]), rtol=1e-12)
    np.testing.assert_allclose(read_times(drive.oxts_times, numbers), (np.array(numbers) - 1) * 0.125)
    assert (folder / "image_02/timestamps.txt").read_text().splitlines()[1] == "2027-03-31 12:00:00.125000000"
    camera = drive.camera(2)
    assert (camera.size, camera.T_cam_velo, camera.horizon) == (SIZE, None, 20.5)
    np.testing.assert_allclose(camera.K, K, rtol=1e-12)
    assert layout.check_calibration([folder], camera, replace=False)
    assert read_calibration(folder.parent, 2).horizon is None, "two recordings of a camera may have two horizons"


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
