"""KITTI raw's folders, scans, calibration, packets and timestamps."""

import os
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from pipeline.base.errors import InputError
from pipeline.base.hashes import digest
from pipeline.camera.geometry import depth_image, project, transform
from pipeline.camera.images import read_pixels
from pipeline.ingest import packets
from pipeline.ingest.calibration import read_calibration
from pipeline.ingest.datasets import kitti, sample
from pipeline.ingest.datasets.kitti import KittiDrive, read_scan
from steer.measure import READING
from tests.kitti_drive import DATE, DRIVE, scan, write, write_calibration, write_drive


def test_a_fingerprint_detects_a_file_that_was_extracted_again(tmp_path):
    folder = write_drive(tmp_path, truth=True)
    reading = SimpleNamespace(cameras=[2])

    def fingerprint(dataset: Any = kitti) -> str:
        return digest(dataset.fingerprint(DRIVE, reading, tmp_path))

    hashes = {fingerprint()}
    for name in (
        "image_02/data/0000000001.png",
        "velodyne_points/data/0000000002.bin",
        "../calib_velo_to_cam.txt",
    ):
        before = (folder / name).stat()
        write(folder / name, (folder / name).read_bytes())
        os.utime(folder / name, ns=(before.st_atime_ns, before.st_mtime_ns))  # as unzip does
        hashes.add(fingerprint())
    assert len(hashes) == 4
    content = fingerprint(sample)
    write(folder / name, (folder / name).read_bytes())
    assert fingerprint(sample) == content
    write(folder / "truth/cls/0000000000.png", "other")
    assert fingerprint(sample) != content


@pytest.mark.real
def test_real_scan_lands_on_the_depth_benchmark(real_kitti):
    """KITTI's depth benchmark projected the same scan, after motion compensation: it is close."""
    drive = KittiDrive(real_kitti / DATE / "2011_09_26_drive_0001_sync")
    camera = drive.read_camera(2)
    png = (
        real_kitti
        / "depth_benchmark/2011_09_26_drive_0001_sync_0000000005_velodyne_raw_image_02.png"
    )
    expected = read_pixels(png) / 256
    points = read_scan(drive.scans[5])[:, :3].astype(np.float64)
    xyz = transform(camera.T_cam_velo, points)

    def agree(shift: float) -> tuple[int, float]:
        """Return how many pixels have both depths, and the median error."""
        K = camera.K + shift * np.array([[0, 0, 1], [0, 0, 1], [0, 0, 0]])
        depth = depth_image(xyz, K, camera.size)
        both = (depth > 0) & (expected > 0)
        return int(both.sum()), float(np.median(np.abs(depth - expected)[both]))

    pixels, error_m = agree(0.0)
    assert error_m <= 0.05
    assert pixels > 6000
    # Integer coordinates are pixel centres: shifted by half a pixel or more, fewer points agree.
    for shift in (-1.0, -0.5, 0.5, 1.0):
        shifted_pixels, _ = agree(shift)
        assert shifted_pixels < 0.8 * pixels


def test_projection_equals_kittis_formula(tmp_path):
    """Second route, of KITTI's paper, by the files' numbers: y = P_rect R_rect T_velo_to_cam x."""
    write_calibration(tmp_path)
    text = (tmp_path / "calib_cam_to_cam.txt").read_text()
    text += (tmp_path / "calib_velo_to_cam.txt").read_text()
    words = dict(line.split(": ") for line in text.splitlines())
    P = np.array(words["P_rect_02"].split(), float).reshape(3, 4)
    R_rect = np.array(words["R_rect_00"].split(), float).reshape(3, 3)
    R = np.array(words["R"].split(), float).reshape(3, 3)
    T = np.array(words["T"].split(), float)

    xyz = np.random.default_rng(0).uniform([3, -5, -2], [40, 5, 2], (50, 3))
    rectified = (xyz @ R.T + T) @ R_rect.T
    u, v, w = (np.column_stack([rectified, np.ones(50)]) @ P.T).T

    camera = read_calibration(tmp_path, 2)
    uv, z = project(transform(camera.T_cam_velo, xyz), camera.K)
    np.testing.assert_allclose(z, w, rtol=1e-9)
    np.testing.assert_allclose(uv, np.column_stack([u / w, v / w]), rtol=1e-9)
    assert camera.size == (48, 64)


def test_columns_equal_pykittis():
    from pykitti.utils import OxtsPacket

    assert OxtsPacket._fields == packets.COLUMNS
    assert packets.MOTION == {"speed_mps": 8, "left_mps": 9, "yaw_rate_radps": 22}


def stamps(*seconds: float | str) -> str:
    return "".join(f"2011-09-26 13:02:{second}\n" for second in seconds)


@pytest.mark.parametrize(
    ("times", "note", "problem"),
    [
        (stamps(25.01, 25.11, 25.21, 25.31), "", ""),
        (stamps(25.15, 25.25, 25.35, 25.45), "packets are 0.15 s before the images", ""),
        ("\n" + stamps(25.01, "x", 25.21).replace("\n", "\r\n"), "", ""),
        ("", "times of images and packets cannot be compared (image_02)", ""),
        (stamps(25.3, 25.4, 25.5, 25.6), "", "oxts/timestamps.txt: packets are 0.30 s before"),
        (stamps(24.8, 25.0, 25.2, 25.4), "", "0.05 s after .*, and drift by 0.30 s"),
    ],
)
def test_times_of_images_and_packets(tmp_path, times, note, problem):
    folder = write_drive(tmp_path)
    write(folder / "image_02/timestamps.txt", times)
    with pytest.raises(InputError, match=problem) if problem else nullcontext():
        notes = kitti.open_drive(DRIVE, READING, tmp_path).notes
        assert len(notes) == bool(note)
        assert all(line.startswith(note) for line in notes)


def test_images_that_may_have_been_renumbered_are_noted(tmp_path):
    folder = write_drive(tmp_path)
    (folder / "image_02/data/0000000003.png").unlink()
    notes = kitti.open_drive(DRIVE, READING, tmp_path).notes
    assert notes[-1].startswith("images end at frame 2, packets at 3: if images were renumbered")


def test_packets_and_times_round_trip(tmp_path):
    rng = np.random.default_rng(0)
    path = tmp_path / "a.txt"
    row = rng.uniform(-1, 1, 30)
    row[packets.COLUMNS.index("navstat") :] = [4, 9, 4, 4, 4]
    path.write_bytes(packets.format_packet(row))
    np.testing.assert_allclose(packets.read_packet(path), row, rtol=1e-12)

    time_s = np.cumsum(rng.integers(1, 10**10, 5)) / 1e9
    path.write_bytes(packets.format_times(time_s, "2027_03_31", 8 * 3600))
    np.testing.assert_allclose(packets.read_times(path, [*range(5)]), time_s - time_s[0], atol=1e-9)


@pytest.mark.parametrize(
    ("lines", "frames", "expected"),
    [
        (["25.0", "25.1", "25.25", "25.3", "25.45"], [1, 2, 4], [0, 0.15, 0.35]),  # by number
        # cut out of a longer drive: by position
        (["25.0", "25.1", "25.3"], [100, 101, 103], [0, 0.1, 0.3]),
        (["25.0", "", "25.2"], [0, 2], [0, 0.2]),  # the empty line belongs to no frame
    ],
)
def test_lines_and_frames(tmp_path, lines, frames, expected):
    path = tmp_path / "a.txt"
    texts = [stamps(text) if text else "\n" for text in lines]
    write(path, "".join(texts))
    np.testing.assert_allclose(packets.read_times(path, frames), expected, atol=1e-12)


def read_three(path: Path) -> np.ndarray:
    return packets.read_times(path, [0, 1, 2])


def read_camera(path: Path) -> object:
    """Read a calibration in which a text is replaced, as a file "old→new" says."""
    write_calibration(path.parent)
    calibration = path.parent / "calib_cam_to_cam.txt"
    old, new = path.read_text().split("→")
    text = calibration.read_text()
    assert old in text
    calibration.write_text(text.replace(old, new))
    return read_calibration(path.parent, 2)


def read_angles(path: Path) -> object:
    return packets.read_values(path.rename(path.with_name("steering.csv")))


SCAN = scan(np.random.default_rng(0), 640)
# Reflectance from 0 to 255.
BYTES = (SCAN * np.float32([1, 1, 1, 255])).tobytes()
PLAINLY_WRONG: list[tuple[Callable[[Path], object], str | bytes, str]] = [
    (read_scan, SCAN.tobytes()[:-7], "cut short at 10233 bytes"),
    (
        read_scan,
        SCAN[:400].tobytes(),
        "cut short at -14.7 degrees .*LOWEST_DEG in pipeline/ingest/datasets/kitti.py",
    ),
    (read_scan, BYTES, r"reflectance is .*, expected 0 to 1\. Convert"),
    (read_scan, (0 * SCAN).tobytes(), "no point"),
    (packets.read_packet, "", "got 0"),
    (packets.read_packet, "1.0 " * 22 + "nan " + "1.0 " * 7, "wu = nan"),
    (read_three, stamps(25.0, 25.1), "got 2"),
    (read_three, stamps(25.0, 25.2, 25.1), "time does not increase .*: 0.1 in line 3"),
    (
        read_three,
        stamps(25.0, 25.1, "x"),
        "time is not a date and time: '2011-09-26 13:02:x' in line 3",
    ),
    (read_camera, "P_rect_02: 5.000000000e+01→P_rect_02: inf", "P_rect_02: expected 12 finite"),
    (read_camera, "calib_time:→<html>\ncalib_time:", "not a calibration file"),
    (
        read_angles,
        "frame,steering_rad\n3,2.5\n",
        "steering_rad is implausible .*: '2.5' in line 2",
    ),
    (read_angles, "frame,steering_rad\n0.5,0\n", "frame is not a whole number: 0.5 in line 2"),
]


def test_rays_without_a_return_are_left_out(tmp_path):
    path = tmp_path / "a.bin"
    content = SCAN.copy()
    content[5, :3] = 0
    content[7:9, 1] = np.nan
    write(path, content.tobytes())
    np.testing.assert_array_equal(read_scan(path), np.delete(SCAN, [5, 7, 8], axis=0))


@pytest.mark.parametrize(("read", "content", "problem"), PLAINLY_WRONG)
def test_plainly_wrong_files(tmp_path, read, content, problem):
    write(tmp_path / "a.txt", content)
    with pytest.raises(InputError, match=problem):
        read(tmp_path / "a.txt")
