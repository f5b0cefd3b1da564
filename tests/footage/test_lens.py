"""Test the intrinsics of recordings, and lenses."""

import numpy as np
import pytest

from footage.lens import fisheye, pinhole, undistortion
from pipeline.base.errors import InputError
from pipeline.camera.geometry import camera_rays


def test_field_of_view_spans_the_edges():
    K = pinhole((480, 640), fov_deg=90).K
    # The edges are half a pixel beyond the centres of the outer pixels.
    left = np.linalg.inv(K) @ [-0.5, 0, 1]
    right = np.linalg.inv(K) @ [639.5, 0, 1]
    assert np.rad2deg(np.arctan(right[0]) - np.arctan(left[0])) == pytest.approx(90)
    middle = camera_rays(K, (480, 640))[239:241, 319:321].mean(axis=(0, 1))
    np.testing.assert_allclose(middle, [0, 0, 1], atol=1e-12)


def test_a_fisheye_lens_is_rectified():
    """A point at a known angle from the axis comes to lie where the pinhole sees it."""
    size = (400, 640)
    middle = np.array([319.5, 199.5])
    focal = 320 / np.deg2rad(61)  # of an equidistant lens
    K = f"{focal},{focal},319.5,199.5"
    for intrinsics in ({"fov_deg": 122.0}, {"K": K}):
        camera, rectify = fisheye(size, "0,0,0,0", **intrinsics)
        assert 2 * np.rad2deg(np.arctan(320 / camera.K[0, 0])) == pytest.approx(90)
        for angle, turn in ((0.6, 0.0), (0.5, 2.5)):
            direction = np.array([np.cos(turn), np.sin(turn)])
            u, v = np.rint(middle + focal * angle * direction).astype(int)
            image = np.zeros((*size, 3), np.uint8)
            image[v - 1 : v + 2, u - 1 : u + 2] = 255
            row, column = np.argwhere(rectify(image)[..., 0] > 200).mean(axis=0)
            tangent = (np.array([column, row]) - middle) / camera.K[0, 0]
            np.testing.assert_allclose(tangent, np.tan(angle) * direction, atol=0.006)

    narrow, _ = fisheye(size, "0.1,0,0,0", fov_deg=60)
    assert narrow.K[0, 0] == pytest.approx(320 / np.tan(np.deg2rad(30)), rel=1e-3)
    with pytest.raises(InputError, match=r"cover 122°, more than 100°.*0,0,0,0"):
        pinhole(size, fov_deg=122)


@pytest.mark.parametrize(
    "intrinsics", [{"K": "a,b,c,d"}, {"K": "50,50,65,20"}, {}, {"fov_deg": 90, "K": "1,1,1,1"}]
)
def test_plainly_wrong_intrinsics(intrinsics):
    with pytest.raises(InputError):
        pinhole((48, 64), **intrinsics)


@pytest.mark.parametrize(
    ("distortion", "problem"),
    [
        ("0.1,0,0,x", "expected 4 or 5 numbers"),
        ("0.04,0.02,-0.03,0.01", "Pass these as --fisheye"),
    ],
)
def test_plainly_wrong_distortions(distortion, problem):
    camera = pinhole((48, 64), fov_deg=90)
    with pytest.raises(InputError, match=problem):
        undistortion(camera, distortion)


UDACITY = "2152,2166,268,303"
KITTI = "721.5,721.5,609.6,172.9"
HALF_KITTI = "360.2,361.7,304.0,86.4"


@pytest.mark.parametrize(
    ("K", "height", "width"), [(UDACITY, 480, 640), (KITTI, 375, 1242), (HALF_KITTI, 188, 620)]
)
def test_intrinsics_are_for_the_size_of_the_images(K, height, width):
    undistortion(pinhole((height, width), K=K), "-0.042,-0.89,0,0")
    with pytest.raises(InputError, match="another image size"):
        pinhole((height // 2, width // 2), K=K)
    with pytest.raises(InputError, match="another image size"):
        pinhole((2 * height, 2 * width), K=K)


def test_intrinsics_are_not_for_images_that_are_a_third_larger():
    with pytest.raises(InputError, match="another image size"):
        pinhole((500, 1656), K=KITTI)  # 4 / 3 of its size
