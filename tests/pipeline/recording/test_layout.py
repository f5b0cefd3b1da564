"""The written folder is what stage ingest reads."""

from pathlib import Path

import numpy as np
import pytest

from pipeline.camera.images import read_pixels
from pipeline.kitti.calibration import read_camera
from pipeline.kitti.oxts import make_rows, read_row, read_times
from pipeline.kitti.raw import RawDrive
from pipeline.recording.layout import (
    check_calibration,
    drive_folder,
    write_calibration,
    write_images,
    write_packets,
    write_times,
)
from tests.footage import SIZE, pictures
from tests.kitti_drive import write_calibration as write_full_calibration

DRIVE = "2027_03_31_drive_0001"
K = np.array([[50.0, 0, 31.5], [0, 50.0, 23.5], [0, 0, 1]])


@pytest.mark.parametrize("threads", [1, 3])
def test_files_are_numbered(tmp_path: Path, threads: int) -> None:
    folder = drive_folder(tmp_path, DRIVE)
    images = pictures(9)
    usable = np.arange(9) % 4 != 0
    rows = make_rows(9, vf=np.arange(9.0) / 7)[usable]
    time_s = 1e9 + np.arange(9) * 0.125
    write_images(folder, ((int(number), images[number]) for number in np.flatnonzero(usable)), threads)
    write_packets(folder, rows, usable)
    write_times(folder, usable, time_s, ("oxts", "image_02"))

    drive = RawDrive(folder)
    numbers = [1, 2, 3, 5, 6, 7]
    assert list(drive.images(2)) == list(drive.oxts) == numbers
    np.testing.assert_array_equal([read_pixels(path) for path in drive.images(2).values()], images[numbers])
    np.testing.assert_allclose([read_row(path) for path in drive.oxts.values()], rows, rtol=1e-12)
    np.testing.assert_allclose(read_times(drive.oxts_times, numbers), (np.array(numbers) - 1) * 0.125)
    assert (folder / "image_02/timestamps.txt").read_text().splitlines()[1] == "2027-03-31 12:00:00.125000000"


def test_calibration_round_trip(tmp_path: Path) -> None:
    folder = drive_folder(tmp_path, DRIVE)
    assert not check_calibration(folder, SIZE, K, force=False)
    write_calibration(folder, SIZE, K)
    camera = read_camera(folder.parent, 2)
    assert (camera.size, camera.T_cam_velo) == (SIZE, None)
    np.testing.assert_allclose(camera.K, K, rtol=1e-12)
    write_full_calibration(folder.parent)
    assert check_calibration(folder, SIZE, read_camera(folder.parent, 2).K, force=False)
