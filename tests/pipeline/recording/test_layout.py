"""The written folder is what stage ingest reads; the drives of a date share one calibration."""

import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from pipeline.base.errors import InputError
from pipeline.camera.pixels import read_pixels
from pipeline.kitti.calibration import read_camera
from pipeline.kitti.oxts import make_rows, read_row, read_times
from pipeline.kitti.raw import RawDrive
from pipeline.recording import layout
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


@pytest.mark.parametrize(
    "name", ["drive1", "2027_03_31", "2027_03_31_drive_1", "2027_02_30_drive_0001", "0001_03_31_drive_0001", "../x"]
)
def test_names_of_drives(tmp_path: Path, name: str) -> None:
    assert drive_folder(tmp_path, DRIVE) == tmp_path / f"2027_03_31/{DRIVE}_sync"
    with pytest.raises(InputError) as raised:
        drive_folder(tmp_path, name)
    assert raised.value.where == "--drive"


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


def test_gap_of_more_than_an_hour(tmp_path: Path) -> None:
    usable, time_s = np.array([True, False, True, True]), np.array([0.0, 3000.0, 3700.0, 3701.0])
    with pytest.raises(InputError, match="images 0 and 2 are 3700 s apart"):
        write_times(tmp_path, usable, time_s, ())


def test_memory_is_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    done, waiting, requested = list[Path](), list[int](), threading.Semaphore(0)

    def slow_write(path: Path, image: np.ndarray) -> None:
        requested.acquire(timeout=5)  # not before later images were requested
        done.append(path)

    def images() -> Iterator[tuple[int, np.ndarray]]:
        for number in range(20):
            waiting.append(number - len(done))
            if number >= 3:
                requested.release()
            yield number, np.zeros((*SIZE, 3), np.uint8)
        requested.release(3)

    monkeypatch.setattr(layout, "write_png", slow_write)
    write_images(tmp_path / "a", images(), threads=2)
    assert len(done) == 20
    assert max(waiting) <= 4


def test_error_of_a_thread_is_raised(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(path: Path, image: np.ndarray) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(layout, "write_png", fail)
    with pytest.raises(OSError, match="No space"):
        write_images(tmp_path / "a", [(0, np.zeros((*SIZE, 3), np.uint8))], threads=1)


def test_calibration_round_trip(tmp_path: Path) -> None:
    folder = drive_folder(tmp_path, DRIVE)
    assert not check_calibration(folder, SIZE, K, force=False)
    write_calibration(folder, SIZE, K)
    camera = read_camera(folder.parent, 2)
    assert (camera.size, camera.T_cam_velo) == (SIZE, None)
    np.testing.assert_allclose(camera.K, K, rtol=1e-12)
    write_full_calibration(folder.parent)
    assert check_calibration(folder, SIZE, read_camera(folder.parent, 2).K, force=False)


def test_another_camera_is_refused(tmp_path: Path) -> None:
    folder = drive_folder(tmp_path, DRIVE)
    write_calibration(folder, SIZE, K)
    folder.mkdir()
    other = K + np.diag([0.1, 0.1, 0])
    with pytest.raises(InputError, match=r"64 x 48, focal length 50.00, .*50.10.*--force"):
        check_calibration(folder, SIZE, other, force=False)
    assert not check_calibration(folder, SIZE, other, force=True)
    (folder.parent / "2027_03_31_drive_0002_sync").mkdir()
    with pytest.raises(InputError, match=r"used by 2027_03_31_drive_0002_sync") as raised:
        check_calibration(folder, SIZE, other, force=True)
    assert "--drive" in raised.value.fix
    with pytest.raises(InputError, match="65 x 48"):
        check_calibration(folder, (48, 65), K, force=True)
