"""Test the intrinsics of recordings, and lenses."""

from pathlib import Path

import numpy as np
import pytest

from footage.lens import open_lens
from footage.settings import Options
from pipeline.base.errors import InputError

PATH = Path("a.mp4")
UDACITY = "2152,2166,268,303"
KITTI = "721.5,721.5,609.6,172.9"
HALF_KITTI = "360.2,361.7,304.0,86.4"


def test_field_of_view_spans_the_edges():
    camera = open_lens(Options(fov=90), (480, 640), PATH).camera
    # The edges are half a pixel beyond the centres of the outer pixels.
    left = np.linalg.inv(camera.K) @ [-0.5, 239.5, 1]
    right = np.linalg.inv(camera.K) @ [639.5, 239.5, 1]
    np.testing.assert_allclose([left, right], [[-1, 0, 1], [1, 0, 1]], atol=1e-12)


def test_a_fisheye_lens_is_rectified():
    """A point at a known angle from the axis comes to lie where the pinhole sees it."""
    size = (400, 640)
    middle = np.array([319.5, 199.5])
    focal = 320 / np.deg2rad(61)  # of an equidistant lens
    K = f"{focal},{focal},319.5,199.5"
    for intrinsics in ({"fov": 122.0}, {"K": K}):
        _, rectify, camera = open_lens(Options(fisheye="0,0,0,0", **intrinsics), size, PATH)
        assert 2 * np.rad2deg(np.arctan(320 / camera.K[0, 0])) == pytest.approx(90)
        for angle, turn in ((0.6, 0.0), (0.5, 2.5)):
            direction = np.array([np.cos(turn), np.sin(turn)])
            u, v = np.rint(middle + focal * angle * direction).astype(int)
            image = np.zeros((*size, 3), np.uint8)
            image[v - 1 : v + 2, u - 1 : u + 2] = 255
            row, column = np.argwhere(rectify(image)[..., 0] > 200).mean(axis=0)
            tangent = (np.array([column, row]) - middle) / camera.K[0, 0]
            np.testing.assert_allclose(tangent, np.tan(angle) * direction, atol=0.006)

    narrow = open_lens(Options(fisheye="0.1,0,0,0", fov=60), size, PATH).camera
    assert narrow.K[0, 0] == pytest.approx(320 / np.tan(np.deg2rad(30)), rel=1e-3)


@pytest.mark.parametrize(
    ("K", "height", "width"), [(UDACITY, 480, 640), (KITTI, 375, 1242), (HALF_KITTI, 188, 620)]
)
def test_intrinsics_are_for_the_size_of_the_images(K, height, width):
    options = Options(K=K)
    open_lens(options, (height, width), PATH)
    for size in ((height // 2, width // 2), (2 * height, 2 * width)):
        with pytest.raises(InputError, match="another image size"):
            open_lens(options, size, PATH)


@pytest.mark.parametrize(
    ("options", "problem"),
    [
        ({"K": "a,b,c,d"}, "expected 4 numbers"),
        ({"K": "50,50,65,20"}, "--K"),
        ({}, "--fov DEGREES"),
        ({"fov": 90, "K": "1,1,1,1"}, "--fov DEGREES"),
        ({"fov": 122}, "cover 122°, more than 100°.*0,0,0,0"),
        ({"fov": 90, "distortion": "0.1,0,0,x"}, "expected 4 or 5 numbers"),
        ({"fov": 90, "distortion": "0.04,0.02,-0.03,0.01"}, "Pass these as --fisheye"),
        ({"fov": 90, "distortion": "0,0,0,0", "fisheye": "0,0,0,0"}, "--distortion or --fisheye"),
    ],
)
def test_plainly_wrong_lenses(options, problem):
    with pytest.raises(InputError, match=problem):
        open_lens(Options(**options), (48, 64), PATH)
