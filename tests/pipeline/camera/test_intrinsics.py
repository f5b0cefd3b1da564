"""Intrinsics as people know them: a file, an angle, four numbers; and what cannot be one."""

from pathlib import Path

import numpy as np
import pytest

from pipeline.base.errors import InputError
from pipeline.camera.geometry import rays, scale_K
from pipeline.camera.intrinsics import intrinsics
from pipeline.kitti.calibration import read_camera
from tests.kitti_drive import SIZE, write_calibration


def test_an_angle_is_between_the_edges() -> None:
    K = intrinsics((480, 640), fov_deg=90)
    left, right = np.linalg.inv(K) @ [-0.5, 0, 1], np.linalg.inv(K) @ [639.5, 0, 1]  # half a pixel beyond the centres
    assert np.rad2deg(np.arctan(right[0]) - np.arctan(left[0])) == pytest.approx(90)
    middle = rays(K, (480, 640))[239:241, 319:321].mean(axis=(0, 1))
    np.testing.assert_allclose(middle, [0, 0, 1], atol=1e-12)


def test_four_numbers() -> None:
    np.testing.assert_array_equal(intrinsics((48, 64), K="50,51, 31.5,22"), [[50, 0, 31.5], [0, 51, 22], [0, 0, 1]])


def test_a_calibration_file_as_ingest_reads_it(tmp_path: Path) -> None:
    write_calibration(tmp_path)
    K = read_camera(tmp_path, 2).K
    np.testing.assert_array_equal(intrinsics(SIZE, calib=tmp_path / "calib_cam_to_cam.txt"), K)
    half = (SIZE[0] // 2, SIZE[1] // 2)
    np.testing.assert_array_equal(intrinsics(half, calib=tmp_path / "calib_cam_to_cam.txt"), scale_K(K, SIZE, half))


def test_a_calibration_of_another_camera_than_the_second(tmp_path: Path) -> None:
    write_calibration(tmp_path, [0])
    assert intrinsics(SIZE, calib=tmp_path / "calib_cam_to_cam.txt")[0, 0] == 50


@pytest.mark.real
def test_a_real_calibration(real_kitti: Path) -> None:
    K = intrinsics((375, 1242), calib=real_kitti / "2011_09_26/calib_cam_to_cam.txt")
    assert K[0, 0] == pytest.approx(721.5377)
    assert intrinsics((188, 621), calib=real_kitti / "2011_09_26/calib_cam_to_cam.txt")[0, 0] == pytest.approx(
        360.77, abs=0.01
    )


@pytest.mark.parametrize(
    ("told", "message"), [({}, "said nowhere"), ({"fov_deg": 90, "K": "1,1,1,1"}, "said more than once")]
)
def test_one_way_is_needed(told: dict, message: str) -> None:
    with pytest.raises(
        InputError, match=rf"{message}: say one of --calib FILE .*, --fov DEGREES .* or --K fx,fy,cx,cy"
    ):
        intrinsics((48, 64), **told)


@pytest.mark.parametrize("fov_deg", [0, 180, float("nan"), -90])
def test_angles_that_no_pinhole_has(fov_deg: float) -> None:
    with pytest.raises(InputError, match="not between 5 and 170 degrees"):
        intrinsics((48, 64), fov_deg=fov_deg)


@pytest.mark.parametrize(
    ("K", "message"),
    [
        ("1,2,3", "not four numbers"),
        ("a,b,c,d", "not four numbers"),
        ("50,50,64,20", "in the image of 64 x 48 pixels"),
        ("50,50,20,-1", "in the image"),
        ("0,50,20,20", "positive"),
        ("nan,50,20,20", "positive"),
        ("50,inf,20,20", "positive"),
    ],
)
def test_numbers_that_cannot_be(K: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        intrinsics((48, 64), K=K)


def test_a_file_that_is_not_for_these_images(tmp_path: Path) -> None:
    write_calibration(tmp_path)
    with pytest.raises(InputError, match=r"is for images of 64 x 48 pixels, these are 64 x 40"):
        intrinsics((40, 64), calib=tmp_path / "calib_cam_to_cam.txt")
    for name, message in (("calib_velo_to_cam.txt", "has no P_rect_02"), ("nothing.txt", "is missing")):
        with pytest.raises(InputError, match=rf"{message}\. --calib wants a KITTI calib_cam_to_cam.txt"):
            intrinsics(SIZE, calib=tmp_path / name)
