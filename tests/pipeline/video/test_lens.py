"""Intrinsics from a file or an angle."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from pipeline.base.errors import InputError
from pipeline.camera.geometry import rays
from pipeline.kitti.raw import read_calibration
from pipeline.video.lens import pinhole, undistortion
from tests.kitti_drive import SIZE, write_calibration


def test_field_of_view_spans_the_edges() -> None:
    K = pinhole((480, 640), fov_deg=90).K
    left, right = np.linalg.inv(K) @ [-0.5, 0, 1], np.linalg.inv(K) @ [639.5, 0, 1]  # half a pixel beyond the centres
    assert np.rad2deg(np.arctan(right[0]) - np.arctan(left[0])) == pytest.approx(90)
    middle = rays(K, (480, 640))[239:241, 319:321].mean(axis=(0, 1))
    np.testing.assert_allclose(middle, [0, 0, 1], atol=1e-12)


def test_calibration_file_as_ingest_reads_it(tmp_path: Path) -> None:
    calib = tmp_path / "calib_cam_to_cam.txt"
    write_calibration(tmp_path)
    camera = read_calibration(tmp_path, 2)
    np.testing.assert_array_equal(pinhole(SIZE, calib=calib).K, camera.K)
    half = (SIZE[0] // 2, SIZE[1] // 2)
    np.testing.assert_array_equal(pinhole(half, calib=calib).K, camera.scaled(half).K)
    for name, size, problem in (("cam_to_cam", (40, 64), "aspect ratio"), ("velo_to_cam", SIZE, "no entry P_rect_02")):
        with pytest.raises(InputError, match=problem):
            pinhole(size, calib=tmp_path / f"calib_{name}.txt")


@pytest.mark.parametrize(
    ("given", "where"),
    [
        ({"fov_deg": 180}, "--fov"),
        ({"K": "a,b,c,d"}, "--K"),
        ({"K": "50,50,65,20"}, "--K"),
        ({}, ""),
        ({"fov_deg": 90, "K": "1,1,1,1"}, ""),
    ],
)
def test_plainly_wrong_intrinsics(given: dict[str, Any], where: str) -> None:
    with pytest.raises(InputError) as raised:
        pinhole((48, 64), **given)
    assert raised.value.where == where


def test_undistorted_images_show_each_direction_at_its_pixel() -> None:
    camera = pinhole((120, 160), K="150,160,75,62")
    coefficients = np.array([-0.25, 0.06, 0.003, -0.002, 0.01])
    v, u = np.mgrid[:120, :160].astype(np.float64)
    pixels = np.stack([u, v], axis=-1).reshape(-1, 1, 2)
    directions = cv2.undistortPoints(pixels, camera.K, coefficients).reshape(120, 160, 2)

    def colours(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return np.stack([128 + 150 * x, 128 + 150 * y, 128 + 80 * (x - y)], axis=-1)

    recorded = np.rint(colours(directions[..., 0], directions[..., 1])).astype(np.uint8)
    rectified = undistortion(camera, ",".join(map(str, coefficients)))(recorded)
    expected = colours(*rays(camera.K, camera.size)[..., :2].transpose(2, 0, 1))
    inside = rectified.any(axis=-1)
    assert inside[10:-10, 10:-10].all()
    assert np.abs(rectified - expected)[10:-10, 10:-10].max() < 2
    assert np.abs(recorded - expected)[10:-10, 10:-10].max() > 5
    same = undistortion(camera, "0,0,0,0")(recorded)
    np.testing.assert_array_equal(same, recorded)


@pytest.mark.parametrize("text", ["0.1,0,0,x", "-2,0,0,0"])
def test_a_distortion_that_is_none(text: str) -> None:
    with pytest.raises(InputError) as raised:
        undistortion(pinhole((120, 160), K="100,100,80,60"), text)
    assert raised.value.where == "--distortion"
