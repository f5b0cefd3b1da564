"""The written folder is what stage ingest reads, and packets are consistent: position, heading and velocities."""

from pathlib import Path

import numpy as np
import pytest

from pipeline.camera.camera import Camera
from pipeline.camera.images import read_pixels
from pipeline.kitti.oxts import COLUMNS, EARTH_RADIUS_M, VF, WU, YAW, read_row, read_times
from pipeline.kitti.raw import RawDrive, read_calibration
from pipeline.recording.layout import (
    check_calibration,
    drive_folder,
    packets,
    write_calibration,
    write_images,
    write_packets,
    write_times,
)
from pipeline.recording.track import Rates
from tests.footage import SIZE, pictures
from tests.kitti_drive import write_calibration as write_full_calibration

DRIVE = "2027_03_31_drive_0001"
SAMPLES_S = np.arange(0, 20, 0.01)
IMAGES_S = np.sort(np.random.default_rng(0).uniform(1, 19, 170))
LAT, LON, VN, VE, AL, WZ = (COLUMNS.index(name) for name in ("lat", "lon", "vn", "ve", "al", "wz"))
K = np.array([[50.0, 0, 31.5], [0, 50.0, 23.5], [0, 0, 1]])


@pytest.mark.parametrize("threads", [1, 3])
def test_files_are_numbered(tmp_path: Path, threads: int) -> None:
    folder = drive_folder(tmp_path, DRIVE, force=False)
    images = pictures(9)
    usable = np.arange(9) % 4 != 0
    time_s = 1e9 + np.arange(9) * 0.125
    rates = Rates(time_s, np.arange(9.0) / 7, np.zeros(9))
    write_images(folder, ((int(number), images[number]) for number in np.flatnonzero(usable)), threads)
    write_packets(folder, rates, time_s, usable)
    write_times(folder, usable, time_s, ("oxts", "image_02"))

    drive = RawDrive(folder)
    numbers = [1, 2, 3, 5, 6, 7]
    assert list(drive.images(2)) == list(drive.oxts) == numbers
    np.testing.assert_array_equal([read_pixels(path) for path in drive.images(2).values()], images[numbers])
    np.testing.assert_allclose(
        [read_row(path) for path in drive.oxts.values()], packets(rates, time_s[usable]), rtol=1e-12
    )
    np.testing.assert_allclose(read_times(drive.oxts_times, numbers), (np.array(numbers) - 1) * 0.125)
    assert (folder / "image_02/timestamps.txt").read_text().splitlines()[1] == "2027-03-31 12:00:00.125000000"


def test_calibration_round_trip(tmp_path: Path) -> None:
    folder = drive_folder(tmp_path, DRIVE, force=False)
    assert not check_calibration([folder], Camera(K, SIZE), force=False)
    write_calibration(folder.parent, Camera(K, SIZE))
    camera = read_calibration(folder.parent, 2)
    assert (camera.size, camera.T_cam_velo) == (SIZE, None)
    np.testing.assert_allclose(camera.K, K, rtol=1e-12)
    write_full_calibration(folder.parent)
    assert check_calibration([folder], read_calibration(folder.parent, 2), force=False)


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
