"""The folder is one that stage ingest reads; a date's drives share one calibration."""

import shutil
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from pipeline.camera.png import read_png

from pipeline.base.errors import InputError
from pipeline.kitti.calibration import read_camera
from pipeline.kitti.oxts import make_rows, read_row, read_times
from pipeline.kitti.raw import RawDrive
from pipeline.recording import layout
from pipeline.recording.layout import check_calibration, drive_folder, write_calibration, write_images, write_packets
from tests.footage import SIZE, pictures
from tests.kitti_drive import write_calibration as write_full_calibration

K = np.array([[50.0, 0, 31.5], [0, 50.0, 23.5], [0, 0, 1]])


def test_a_drive_s_place(tmp_path: Path) -> None:
    assert drive_folder(tmp_path, "2027_03_31_drive_0001") == tmp_path / "2027_03_31/2027_03_31_drive_0001_sync"


@pytest.mark.parametrize("name", ["drive1", "2027_03_31", "2027_03_31_drive_1", "2027_02_30_drive_0001", "../x"])
def test_what_is_no_drive_s_name(tmp_path: Path, name: str) -> None:
    with pytest.raises(InputError, match="is not a drive's name: a date and four digits, as 2027_03_31_drive_0001"):
        drive_folder(tmp_path, name)


@pytest.mark.parametrize("threads", [1, 3])
def test_files_are_found_by_number(tmp_path: Path, threads: int) -> None:
    folder = drive_folder(tmp_path, "2027_03_31_drive_0001")
    images = pictures(9)
    kept = np.arange(9) % 4 != 0
    rows = make_rows(9, vf=np.arange(9.0) / 7)[kept]
    time_s = 1e9 + np.arange(9) * 0.125
    write_images(folder, ((int(number), images[number]) for number in np.flatnonzero(kept)), threads)
    write_packets(folder, rows, kept, time_s)

    drive = RawDrive(folder)
    numbers = [1, 2, 3, 5, 6, 7]
    assert list(drive.images(2)) == list(drive.oxts) == numbers
    np.testing.assert_array_equal([read_png(path) for path in drive.images(2).values()], images[numbers])
    np.testing.assert_allclose([read_row(path) for path in drive.oxts.values()], rows, rtol=1e-12)
    np.testing.assert_allclose(read_times(drive.oxts_times, numbers), (np.array(numbers) - 1) * 0.125)
    assert (folder / "image_02/timestamps.txt").read_text().splitlines()[1] == "2027-03-31 12:00:00.125000000"


def test_memory_is_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    done, waiting = list[Path](), list[int]()

    def slowly(path: Path, image: np.ndarray) -> None:
        time.sleep(0.002)  # the images come faster
        done.append(path)

    def images() -> Iterator[tuple[int, np.ndarray]]:
        for number in range(40):
            waiting.append(number - len(done))
            yield number, np.zeros((*SIZE, 3), np.uint8)

    monkeypatch.setattr(layout, "_write_png", slowly)
    write_images(tmp_path / "a", images(), threads=2)
    assert len(done) == 40
    assert max(waiting) <= 4


def test_an_error_of_a_thread_is_raised(tmp_path: Path) -> None:
    (tmp_path / "a/image_02").mkdir(parents=True)
    images = ((number, np.zeros((*SIZE, 3), np.uint8)) for number in range(3))

    def taken() -> Iterator[tuple[int, np.ndarray]]:
        for number, image in images:
            yield number, image
            shutil.rmtree(tmp_path / "a/image_02/data", ignore_errors=True)

    with pytest.raises(FileNotFoundError):
        write_images(tmp_path / "a", taken(), threads=1)


def test_a_calibration_is_what_ingest_reads(tmp_path: Path) -> None:
    folder = drive_folder(tmp_path, "2027_03_31_drive_0001")
    check_calibration(folder, SIZE, K, force=False)
    write_calibration(folder, SIZE, K)
    camera = read_camera(folder.parent, 2)
    assert camera.size == SIZE
    assert camera.T_cam_velo is None
    np.testing.assert_allclose(camera.K, K, rtol=1e-12)


def test_a_date_s_own_calibration_stays_if_it_says_the_same(tmp_path: Path) -> None:
    folder = drive_folder(tmp_path, "2027_03_31_drive_0001")
    write_full_calibration(folder.parent)
    before = (folder.parent / "calib_cam_to_cam.txt").read_bytes()
    own = read_camera(folder.parent, 2).K
    check_calibration(folder, SIZE, own, force=False)
    write_calibration(folder, SIZE, own)
    assert (folder.parent / "calib_cam_to_cam.txt").read_bytes() == before


def test_another_camera_is_refused(tmp_path: Path) -> None:
    folder = drive_folder(tmp_path, "2027_03_31_drive_0001")
    write_calibration(folder, SIZE, K)
    folder.mkdir()
    other = K + np.diag([0.1, 0.1, 0])
    message = r"calibration of another camera \(64 x 48, focal length 50.00, .*\) than this one \(.*50.10"
    with pytest.raises(InputError, match=message + r".*--force replaces it"):
        check_calibration(folder, SIZE, other, force=False)
    check_calibration(folder, SIZE, other, force=True)
    (folder.parent / "2027_03_31_drive_0002_sync").mkdir()
    with pytest.raises(InputError, match=message + r".*2027_03_31_drive_0002_sync needs it"):
        check_calibration(folder, SIZE, other, force=True)
    with pytest.raises(InputError, match="give --drive another date"):
        check_calibration(folder, (48, 65), K, force=True)
