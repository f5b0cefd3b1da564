"""Calibration files: which point of a scan projects to which pixel."""

from pathlib import Path

import numpy as np
import pytest

from pipeline.base.errors import InputError
from pipeline.camera.geometry import project, transform
from pipeline.kitti.raw import read_calibration
from tests.kitti_drive import write_calibration


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
        ("S_rect_02: 64", "S_rect_02: 64000", "implausible image size"),
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

    theirs = pykitti.raw(str(real_kitti), "2011_09_26", "0052").calib
    ours = read_calibration(real_kitti / "2011_09_26", 2)
    assert ours.T_cam_velo is not None
    np.testing.assert_allclose(ours.K, theirs.K_cam2, rtol=1e-12)
    np.testing.assert_allclose(ours.T_cam_velo[:3, :3], theirs.T_cam2_velo[:3, :3], atol=1e-12)
    # pykitti leaves out P_rect's last column but for x: millimetres.
    np.testing.assert_allclose(ours.T_cam_velo[:3, 3], theirs.T_cam2_velo[:3, 3], atol=0.004)
