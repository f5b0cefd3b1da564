"""KITTI raw's folders and scans."""

import os
from pathlib import Path

import numpy as np
import pytest

from pipeline.base.errors import DamagedFile, InputError
from pipeline.camera.geometry import depth_image, project, transform
from pipeline.camera.images import read_pixels
from pipeline.kitti.raw import KittiDrive, find_drives, read_calibration, read_scan
from tests.kitti_drive import DATE, DRIVE, scan, write, write_calibration, write_drive


def test_files_are_keyed_on_frame_numbers(tmp_path: Path) -> None:
    folder = write_drive(tmp_path, frames=[3, 4, 7])
    data = folder / "velodyne_points/data"
    for junk in ("._0000000003.bin", "0000000005.bin.part", "readme.txt"):
        write(data / junk, "")
    (data / "0000000004.bin").unlink()
    raw = KittiDrive(folder)
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

    def changes(by_content: bool = False) -> str:
        return KittiDrive(folder).fingerprint([2], by_content=by_content)

    first, content = changes(), changes(by_content=True)
    assert changes() == first
    hashes = {first}
    for name in ("image_02/data/0000000001.png", "velodyne_points/data/0000000002.bin", "truth/cls/0000000000.png"):
        path = folder / name
        before = path.stat()
        write(path, path.read_bytes())
        os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns))  # as unzip does
        hashes.add(changes())
    assert len(hashes) == 4
    assert changes(by_content=True) == content


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


@pytest.mark.real
def test_real_scan_lands_on_the_depth_benchmark(real_kitti: Path) -> None:
    """KITTI's depth benchmark projected the same scan, after motion compensation, so that it is only close."""
    raw = KittiDrive(real_kitti / DATE / "2011_09_26_drive_0001_sync")
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


def test_projection_equals_kittis_formula(tmp_path: Path) -> None:
    """Second route, from KITTI's paper: y = P_rect R_rect T_velo_to_cam x, with the files' numbers."""
    write_calibration(tmp_path, [0, 2])
    texts = [(tmp_path / f"calib_{name}.txt").read_text() for name in ("cam_to_cam", "velo_to_cam")]
    lines = dict(line.split(": ") for line in "".join(texts).splitlines())
    P, R_rect, R, T = (np.array(lines[key].split(), float) for key in ("P_rect_02", "R_rect_00", "R", "T"))
    xyz = np.random.default_rng(0).uniform([3, -5, -2], [40, 5, 2], (50, 3))
    reference = (xyz @ R.reshape(3, 3).T + T) @ R_rect.reshape(3, 3).T
    expected = np.column_stack([reference, np.ones(50)]) @ P.reshape(3, 4).T

    camera = read_calibration(tmp_path, 2)
    assert camera.T_cam_velo is not None
    uv, z = project(transform(camera.T_cam_velo, xyz), camera.K)
    np.testing.assert_allclose(z, expected[:, 2], rtol=1e-9)
    np.testing.assert_allclose(uv, expected[:, :2] / expected[:, 2:], rtol=1e-9)
    assert camera.size == (48, 64)


@pytest.mark.parametrize(
    ("old", "new", "problem"),
    [
        ("P_rect_02: 5.000000000e+01", "P_rect_02: inf", "P_rect_02: expected 12 finite"),
        ("R_rect_00: 9", "R_rect_00: -9", "expected a rotation"),
        ("calib_time:", "<html>\ncalib_time:", "not a calibration file"),
    ],
)
def test_damaged_calibration(tmp_path: Path, old: str, new: str, problem: str) -> None:
    write_calibration(tmp_path)
    path = tmp_path / "calib_cam_to_cam.txt"
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new))
    with pytest.raises(InputError, match=problem) as raised:
        read_calibration(tmp_path, 2)
    assert raised.value.where.startswith(str(path))
    assert raised.value.fix


@pytest.mark.real
def test_real_calibration_agrees_with_pykitti(real_kitti: Path) -> None:
    import pykitti

    reference = pykitti.raw(str(real_kitti), "2011_09_26", "0052").calib
    camera = read_calibration(real_kitti / "2011_09_26", 2)
    assert camera.T_cam_velo is not None
    np.testing.assert_allclose(camera.K, reference.K_cam2, rtol=1e-12)
    np.testing.assert_allclose(camera.T_cam_velo[:3, :3], reference.T_cam2_velo[:3, :3], atol=1e-12)
    # pykitti leaves out P_rect's last column but for x: millimetres.
    np.testing.assert_allclose(camera.T_cam_velo[:3, 3], reference.T_cam2_velo[:3, 3], atol=0.004)
