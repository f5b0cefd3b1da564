"""Resizing: pixels move as scale_K says, and depth and classes are never mixed."""

from pathlib import Path

import numpy as np
import pytest

from pipeline.base.errors import InputError
from pipeline.camera.geometry import scale_K
from pipeline.camera.images import read_classes, read_depth, read_image
from tests.kitti_drive import write_png

SIZE, SMALL = (60, 120), (20, 30)


def ramps() -> np.ndarray:
    """Return [H,W,3] whose pixels hold their own coordinates (u, v, 0)."""
    v, u = np.mgrid[: SIZE[0], : SIZE[1]]
    return np.stack([u, v, 0 * u], axis=-1).astype(np.uint8)


def old_coordinates() -> np.ndarray:
    """Return, for each pixel of the resized image, where it lies in the original according to scale_K."""
    back = np.linalg.inv(scale_K(np.eye(3), SIZE, SMALL))
    v, u = np.mgrid[: SMALL[0], : SMALL[1]]
    return (np.stack([u, v, np.ones_like(u)], axis=-1) @ back.T)[..., :2]


def test_image_moves_as_scale_k_says(tmp_path: Path) -> None:
    write_png(tmp_path / "a.png", ramps())
    resized = read_image(tmp_path / "a.png", SIZE, SMALL)
    assert np.abs(resized[..., :2] - old_coordinates()).max() <= 0.5  # what rounding to uint8 may do


def test_depth_picks_the_pixel_in_the_middle(tmp_path: Path) -> None:
    u, v = (ramps()[..., axis].astype(np.uint16) for axis in (0, 1))
    write_png(tmp_path / "a.png", 1000 * v + u)
    picked = read_depth(tmp_path / "a.png", SIZE, SMALL)
    where = np.stack([picked % 1000, picked // 1000], axis=-1)
    assert np.abs(where - old_coordinates()).max() <= 0.5  # an even factor has no middle pixel
    assert picked.dtype == np.uint16


def test_invalid_depth_and_classes_are_not_averaged(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    write_png(tmp_path / "d.png", rng.choice(np.array([0, 20000], np.uint16), SIZE))
    write_png(tmp_path / "c.png", rng.choice(np.array([0, 18, 255], np.uint8), SIZE))
    assert set(np.unique(read_depth(tmp_path / "d.png", SIZE, SMALL))) == {0, 20000}
    assert set(np.unique(read_classes(tmp_path / "c.png", SIZE, SMALL))) == {0, 18, 255}


def test_same_size_is_lossless(tmp_path: Path) -> None:
    pixels = np.random.default_rng(0).integers(0, 256, (*SIZE, 3), np.uint8)
    write_png(tmp_path / "a.png", pixels)
    np.testing.assert_array_equal(read_image(tmp_path / "a.png", SIZE, SIZE), pixels)


def test_grey_is_repeated(tmp_path: Path) -> None:
    pixels = np.random.default_rng(0).integers(0, 256, SIZE, np.uint8)
    write_png(tmp_path / "a.png", pixels)
    image = read_image(tmp_path / "a.png", SIZE, SIZE)
    assert image.shape == (*SIZE, 3)
    assert (image == pixels[..., None]).all()


def test_another_size_than_the_calibration_says(tmp_path: Path) -> None:
    write_png(tmp_path / "a.png", ramps())
    with pytest.raises(InputError, match="is 120 x 60 pixels, the calibration says 121 x 60"):
        read_image(tmp_path / "a.png", (60, 121), SMALL)


@pytest.mark.parametrize(("reader", "dtype"), [(read_depth, np.uint8), (read_classes, np.uint16)])
def test_wrong_depth_of_pixels(tmp_path: Path, reader: object, dtype: type) -> None:
    write_png(tmp_path / "a.png", np.zeros(SIZE, dtype))
    with pytest.raises(InputError, match="are expected"):
        reader(tmp_path / "a.png", SIZE, SMALL)  # type: ignore[operator]
