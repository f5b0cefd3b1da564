"""Intrinsics of recordings, and lenses."""

import numpy as np
import pytest

from pipeline.base.errors import InputError
from pipeline.camera.geometry import rays
from pipeline.camera.lens import fisheye, pinhole, undistortion


def test_field_of_view_spans_the_edges():
    K = pinhole((480, 640), fov_deg=90).K
    # half a pixel beyond the centres
    left, right = np.linalg.inv(K) @ [-0.5, 0, 1], np.linalg.inv(K) @ [639.5, 0, 1]
    assert np.rad2deg(np.arctan(right[0]) - np.arctan(left[0])) == pytest.approx(90)
    middle = rays(K, (480, 640))[239:241, 319:321].mean(axis=(0, 1))
    np.testing.assert_allclose(middle, [0, 0, 1], atol=1e-12)


def test_a_fisheye_lens_is_rectified():
    """A point at a known angle from the axis comes to lie where the pinhole sees it, by --fov as by
    --K.
    """
    size, half = (400, 640), np.deg2rad(61)
    K = f"{320 / half},{320 / half},319.5,199.5"
    for given in ({"fov_deg": 122.0}, {"K": K}):
        camera, straighten = fisheye(size, "0,0,0,0", **given)
        assert 2 * np.rad2deg(np.arctan(320 / camera.K[0, 0])) == pytest.approx(90)
        for angle, turn in ((0.6, 0.0), (0.5, 2.5)):
            direction = np.array([np.cos(turn), np.sin(turn)])
            u, v = np.rint(np.array([319.5, 199.5]) + 320 / half * angle * direction).astype(int)
            image = np.zeros((*size, 3), np.uint8)
            image[v - 1 : v + 2, u - 1 : u + 2] = 255
            row, column = np.argwhere(straighten(image)[..., 0] > 200).mean(axis=0)
            found = (np.array([column, row]) - 319.5 + np.array([0, 120])) / camera.K[0, 0]
            np.testing.assert_allclose(found, np.tan(angle) * direction, atol=0.006)
    assert fisheye(size, "0.1,0,0,0", fov_deg=60)[0].K[0, 0] == pytest.approx(
        320 / np.tan(np.deg2rad(30)), rel=1e-3
    )
    with pytest.raises(InputError, match=r"cover 122°, more than 100°.*0,0,0,0"):
        pinhole(size, fov_deg=122)


@pytest.mark.parametrize(
    "given", [{"K": "a,b,c,d"}, {"K": "50,50,65,20"}, {}, {"fov_deg": 90, "K": "1,1,1,1"}]
)
def test_plainly_wrong_intrinsics(given):
    with pytest.raises(InputError):
        pinhole((48, 64), **given)
    for text, problem in (
        ("0.1,0,0,x", "expected 4 or 5 numbers"),
        ("0.04,0.02,-0.03,0.01", "Pass these as --fisheye"),
    ):
        with pytest.raises(InputError, match=problem):
            undistortion(pinhole((48, 64), fov_deg=90), text)


UDACITY = "2152,2166,268,303"


KITTI = "721.5,721.5,609.6,172.9"


HALF_KITTI = "360.2,361.7,304.0,86.4"


def test_intrinsics_are_for_the_size_of_the_images():
    for K, size in ((UDACITY, (480, 640)), (KITTI, (375, 1242)), (HALF_KITTI, (188, 620))):
        undistortion(pinhole(size, K=K), "-0.042,-0.89,0,0")
        for other in (size[0] // 2, size[1] // 2), (2 * size[0], 2 * size[1]):
            with pytest.raises(InputError, match="another image size"):
                pinhole(other, K=K)
    with pytest.raises(InputError, match="another image size"):
        pinhole((500, 1656), K=KITTI)  # 4 / 3 of its size
