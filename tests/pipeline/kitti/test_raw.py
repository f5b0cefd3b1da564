"""KITTI raw's folders and scans."""

import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from pipeline.base.errors import DamagedFile, InputError
from pipeline.camera.geometry import depth_image, transform
from pipeline.camera.images import read_pixels
from pipeline.kitti.oxts import read_row
from pipeline.kitti.raw import RawDrive, find_drives, read_scan
from tests.kitti_drive import DATE, DRIVE, scan, write, write_drive


def test_files_are_keyed_on_frame_numbers(tmp_path: Path) -> None:
    folder = write_drive(tmp_path, frames=[3, 4, 7])
    data = folder / "velodyne_points/data"
    for junk in ("._0000000003.bin", "0000000005.bin.part", "readme.txt"):
        write(data / junk, "")
    (data / "0000000004.bin").unlink()
    raw = RawDrive(folder)
    assert list(raw.scans) == [3, 7]
    assert list(raw.oxts) == list(raw.images(2)) == [3, 4, 7]
    assert raw.images(2)[7].name == "0000000007.png"
    assert raw.images(0) == raw.truth_depth == {}


def test_find_drives(tmp_path: Path) -> None:
    write_drive(tmp_path)
    assert list(find_drives(tmp_path, [DRIVE])) == [DRIVE]
    with pytest.raises(InputError, match=f"2011_09_26_drive_0010.*did you mean {DRIVE}"):
        find_drives(tmp_path, ["2011_09_26_drive_0010"])
    with pytest.raises(InputError, match="no drives"):
        find_drives(tmp_path / DATE, [DRIVE])


def test_changes_detect_a_file_that_was_extracted_again(tmp_path: Path) -> None:
    folder = write_drive(tmp_path, truth=True)

    def changes() -> str:
        return RawDrive(folder).changes([2])

    first, fingerprint = changes(), RawDrive(folder).fingerprint([2])
    assert changes() == first
    hashes = {first}
    for name in ("image_02/data/0000000001.png", "velodyne_points/data/0000000002.bin", "truth/cls/0000000000.png"):
        path = folder / name
        before = path.stat()
        write(path, path.read_bytes())
        os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns))  # as unzip does
        hashes.add(changes())
    assert len(hashes) == 4
    assert RawDrive(folder).fingerprint([2]) == fingerprint, "an attribute of the ingest file"


def test_damaged_scans(tmp_path: Path) -> None:
    points = scan(np.random.default_rng(0), 640)
    nan, far = points.copy(), points.copy()
    nan[5, 1] = np.nan
    far[5, 1] = 1e20
    for content, message in (
        (b"", "cut short at 0 bytes"),
        (points.tobytes()[:-7], "cut short at 10233 bytes"),
        (points[:400].tobytes(), "its 400 points end at -14.7"),
        (nan.tobytes(), "not finite"),
        (far.tobytes(), "beyond 150 m"),
    ):
        write(tmp_path / "0.bin", content)
        with pytest.raises(DamagedFile, match=message):
            read_scan(tmp_path / "0.bin")


@pytest.mark.parametrize("read", [read_scan, read_row, read_pixels])
def test_pipes_and_devices_are_refused(tmp_path: Path, read: Callable[[Path], np.ndarray]) -> None:
    """Reading one would block, or fill the memory."""
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "device").symlink_to("/dev/zero")
    for name in ("pipe", "device"):
        with pytest.raises(DamagedFile):
            read(tmp_path / name)


@pytest.mark.real
def test_real_scan_lands_on_the_depth_benchmark(real_kitti: Path) -> None:
    """KITTI's depth benchmark projected the same scan, after motion compensation, so that it is only close."""
    raw = RawDrive(real_kitti / DATE / "2011_09_26_drive_0001_sync")
    camera = raw.camera(2)
    assert camera.T_cam_velo is not None
    png = real_kitti / "depth_benchmark/2011_09_26_drive_0001_sync_0000000005_velodyne_raw_image_02.png"
    expected = read_pixels(png) / 256
    xyz = transform(camera.T_cam_velo, read_scan(raw.scans[5])[:, :3].astype(np.float64))

    def agree(shift: float) -> tuple[int, float]:
        K = camera.K + shift * np.array([[0, 0, 1], [0, 0, 1], [0, 0, 0]])
        depth = depth_image(xyz, K, camera.size)
        both = (depth > 0) & (expected > 0)
        return int(both.sum()), float(np.median(np.abs(depth - expected)[both]))

    pixels, error_m = agree(0.0)
    assert error_m <= 0.05
    assert pixels > 6000
    # Integer coordinates are pixel centres: shifted by half a pixel or more, fewer points agree.
    assert all(agree(shift)[0] < 0.8 * pixels for shift in (-1.0, -0.5, 0.5, 1.0))
