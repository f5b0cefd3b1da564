"""Borders that no lens makes, and the crop and the intrinsics without them."""

import re
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest

from footage import borders
from footage.lens import border_doubt, open_lens
from footage.settings import Options
from pipeline.camera.images import Crop
from tests import street

HEIGHT, WIDTH = street.WIDE.size
CROP = Crop(slice(0, 60), slice(12, 92), (60, 100))


def find_crop(images: Sequence[np.ndarray]) -> tuple[slice, slice] | None:
    finder = borders.BorderFinder()
    for image in images:
        finder.add_image(image)
    crop = finder.find_crop()
    return crop and (crop.rows, crop.columns)


def drive() -> list[np.ndarray]:
    """Return images of a drive, of which every tenth is compared."""
    views = [street.view(pose)[0] for pose in street.arc(6, 0.2, 8.0)]
    return [view for view in views for _ in range(10)]


def add_borders(
    left: int, right: int, top: int, bottom: int, noise: int = 0
) -> Callable[[], list[np.ndarray]]:
    """Return a function that makes images with black borders of so many pixels."""

    def make() -> list[np.ndarray]:
        rng = np.random.default_rng(0)
        images = []
        for view in drive():
            pad = ((top, bottom), (left, right), (0, 0))
            image = np.pad(view, pad, constant_values=16).astype(int)
            image[:top] += rng.integers(-noise, noise + 1, image[:top].shape)
            image[top + HEIGHT :] += rng.integers(-noise, noise + 1, (bottom, *image.shape[1:]))
            images.append(image.astype(np.uint8))
        return images

    return make


def standing() -> list[np.ndarray]:
    return [street.view(street.arc(1, 0.2, 8.0)[0])[0]] * 60


@pytest.mark.parametrize(
    ("images", "expected"),
    [
        (drive, None),
        (standing, None),
        (lambda: [np.zeros((48, 64, 3), np.uint8)] * 60, None),
        (add_borders(40, 40, 0, 0), (slice(0, HEIGHT), slice(40, 40 + WIDTH))),
        (add_borders(0, 0, 20, 31), (slice(20, 20 + HEIGHT), slice(0, WIDTH))),
        (add_borders(0, 0, 20, 20, noise=2), (slice(20, 20 + HEIGHT), slice(0, WIDTH))),
        (add_borders(0, 0, 20, 20, noise=4), None),
        # A bonnet or a line of text is at one edge.
        (add_borders(0, 0, 0, 30), None),
        (lambda: add_borders(40, 40, 0, 0)()[:40], None),
    ],
)
def test_borders_are_found_where_no_lens_makes_them(images, expected):
    assert find_crop(images()) == expected


def test_borders_with_text_are_a_part_of_the_picture():
    images = add_borders(0, 0, 40, 40)()
    for image in images:
        image[10:20, 50:60] = 200
    assert find_crop(images) is None


@pytest.mark.parametrize(
    ("lens", "expected"),
    [
        # The lens made the picture between the borders.
        ({"fov": 60.0}, [69.3, 69.3, 39.5, 29.5]),
        ({"K": "100,110,50,28"}, [100, 110, 38, 28]),
        ({"fov": 120.0, "fisheye": "0,0,0,0"}, [38.2, 38.2, 39.5, 29.5]),
    ],
)
def test_the_doubt_has_the_crop_and_its_intrinsics(lens, expected):
    doubt = border_doubt(Options(**lens), CROP)
    assert "80 x 60 pixels" in doubt
    assert "crop=80:60:12:0 out.mp4" in doubt
    passed = re.search(r"--K (\S+)$", doubt)
    assert passed
    assert [float(number) for number in passed[1].split(",")] == pytest.approx(expected, abs=0.05)
    if "fisheye" not in lens:
        open_lens(Options(K=passed[1]), CROP.size, Path("a.mp4"))
