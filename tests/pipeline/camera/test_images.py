"""Resizing: pixels move as scale_K computes, and depth and classes are never mixed."""

from pathlib import Path

import numpy as np
import pytest

from pipeline.camera.geometry import scale_K
from pipeline.camera.images import read_classes, read_depth, read_image
from tests.kitti_drive import write_png

SIZE, SMALL = (60, 120), (20, 30)


def ramps() -> np.ndarray:
    """Return [H,W,3] whose pixels hold their own coordinates (u, v, 0)."""
    v, u = np.mgrid[: SIZE[0], : SIZE[1]]
    return np.stack([u, v, 0 * u], axis=-1).astype(np.uint8)


def original_coordinates() -> np.ndarray:
    """Return the coordinates of each pixel of the resized image in the original, from scale_K."""
    back = np.linalg.inv(scale_K(np.eye(3), SIZE, SMALL))
    v, u = np.mgrid[: SMALL[0], : SMALL[1]]
    return (np.stack([u, v, np.ones_like(u)], axis=-1) @ back.T)[..., :2]


def test_image_moves_with_the_intrinsics(tmp_path: Path) -> None:
    write_png(tmp_path / "a.png", ramps())
    resized = read_image(tmp_path / "a.png", SIZE, SMALL)
    assert np.abs(resized[..., :2] - original_coordinates()).max() <= 0.5  # rounding to uint8


def test_depth_picks_the_central_pixel(tmp_path: Path) -> None:
    u, v = (ramps()[..., axis].astype(np.uint16) for axis in (0, 1))
    write_png(tmp_path / "a.png", 1000 * v + u)
    picked = read_depth(tmp_path / "a.png", SIZE, SMALL)
    where = np.stack([picked % 1000, picked // 1000], axis=-1)
    assert np.abs(where - original_coordinates()).max() <= 0.5  # an even factor has no central pixel
    assert picked.dtype == np.uint16


def test_depth_and_classes_are_not_averaged(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    write_png(tmp_path / "d.png", rng.choice(np.array([0, 20000], np.uint16), SIZE))
    write_png(tmp_path / "c.png", rng.choice(np.array([0, 18, 255], np.uint8), SIZE))
    assert set(np.unique(read_depth(tmp_path / "d.png", SIZE, SMALL))) == {0, 20000}
    assert set(np.unique(read_classes(tmp_path / "c.png", SIZE, SMALL))) == {0, 18, 255}


@pytest.mark.parametrize("channels", [(3,), ()])
def test_same_size_is_lossless_and_grey_is_repeated(tmp_path: Path, channels: tuple[int, ...]) -> None:
    pixels = np.random.default_rng(0).integers(0, 256, (*SIZE, *channels), np.uint8)
    write_png(tmp_path / "a.png", pixels)
    image = read_image(tmp_path / "a.png", SIZE, SIZE)
    np.testing.assert_array_equal(image, pixels if channels else np.repeat(pixels[..., None], 3, axis=-1))
