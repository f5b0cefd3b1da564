"""Calibration files, read back by the pipeline's own reader."""

from pathlib import Path

import numpy as np
import pytest

from pipeline.base.params import load
from pipeline.base.resume import ROOT
from pipeline.camera.geometry import transform
from pipeline.camera.mount import CAMERA_HEIGHT_M, SCANNER_HEIGHT_M
from pipeline.kitti.raw import cameras_in, read_calibration
from pipeline.sample.rig import make_rig, rotation, write_calibration
from pipeline.sample.route import IMU_HEIGHT_M
from pipeline.settings.ingest import Ingest


@pytest.mark.parametrize("date", ["2026_01_01", "2026_01_05"])
def test_calibration_files_describe_the_rig(tmp_path: Path, date: str) -> None:
    rig = make_rig((188, 621), date)
    write_calibration(rig, tmp_path / date)
    assert cameras_in(tmp_path / date) == [0, 1, 2, 3]
    camera = read_calibration(tmp_path / date, 2)
    assert camera.size == (188, 621)
    np.testing.assert_allclose(camera.K, rig.camera.K, atol=1e-9)
    assert camera.T_cam_velo is not None
    np.testing.assert_allclose(camera.T_cam_velo @ rig.T_velo_imu, rig.T_cam2_imu, atol=1e-9)
    np.testing.assert_allclose(camera.T_cam_velo[:3, :3] @ camera.T_cam_velo[:3, :3].T, np.eye(3), atol=1e-9)


def test_sensors_are_placed_as_on_kittis_car() -> None:
    rig = make_rig((188, 621), "2026_01_01")
    camera = transform(np.linalg.inv(rig.T_cam2_imu), np.zeros((1, 3)))[0]
    scanner = transform(np.linalg.inv(rig.T_velo_imu), np.zeros((1, 3)))[0]
    assert abs(camera[2] + IMU_HEIGHT_M - CAMERA_HEIGHT_M) < 0.02
    assert abs(scanner[2] + IMU_HEIGHT_M - SCANNER_HEIGHT_M) < 0.02
    ahead, left, up = rig.T_cam2_imu[:3, :3].T
    np.testing.assert_allclose([ahead[2], left[0], up[1]], [1, -1, -1], atol=1e-3)  # z forward, x right, y down
    np.testing.assert_allclose(rig.camera.K[0, 0], 360.8)
    np.testing.assert_allclose(rig.P_rect[2][0, 3], 44.9 / 2, atol=0.1)


@pytest.mark.parametrize("angle", [(0.3, 0, 0), (0, 0.2, 0), (0, 0, 0.4)])
def test_roll_lifts_the_left_pitch_lowers_the_front_yaw_turns_left(angle: tuple[float, float, float]) -> None:
    ahead, left, _ = rotation(*angle).T
    roll, pitch, yaw = angle
    np.testing.assert_allclose([left[2], ahead[2], ahead[1]], np.sin([roll, -pitch, yaw]), atol=1e-12)


def test_the_test_drives_of_the_sample_have_dates_and_cameras_of_their_own() -> None:
    drives = load(Ingest, ROOT / "params.yaml").drives
    dates = {split: {drive[:10] for drive in getattr(drives, split)} for split in ("train", "val", "test")}
    cameras = {split: {make_rig((96, 320), date).P_rect[2].tobytes() for date in dates[split]} for split in dates}
    assert len(drives.test) >= 20
    assert len(drives.val) >= 8
    for other in ("train", "val"):
        assert not dates["test"] & dates[other]
        assert not cameras["test"] & cameras[other]
