"""Resizing: pixels move as Camera.scaled computes, depth and classes are never mixed; damaged files are refused."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from pipeline.base.errors import DamagedFile
from pipeline.camera.camera import Camera
from pipeline.camera.images import nearest, read_classes, read_depth, read_image, read_pixels, resized, write_png

SIZE, SMALL = (60, 120), (20, 30)


def ramps() -> np.ndarray:
    """Return [H,W,3] whose pixels hold their own coordinates (u, v, 0)."""
    v, u = np.mgrid[: SIZE[0], : SIZE[1]]
    return np.stack([u, v, 0 * u], axis=-1).astype(np.uint8)


def original_coordinates() -> np.ndarray:
    """Return the coordinates of each pixel of the resized image in the original, from Camera.scaled."""
    back = np.linalg.inv(Camera(np.eye(3), SIZE).scaled(SMALL).K)
    v, u = np.mgrid[: SMALL[0], : SMALL[1]]
    return (np.stack([u, v, np.ones_like(u)], axis=-1) @ back.T)[..., :2]


def test_image_moves_with_the_intrinsics(tmp_path: Path) -> None:
    write_png(tmp_path / "a.png", ramps())
    small = resized(read_image(tmp_path / "a.png", SIZE), SMALL)
    assert np.abs(small[..., :2] - original_coordinates()).max() <= 0.5  # rounding to uint8


def test_depth_picks_the_central_pixel(tmp_path: Path) -> None:
    u, v = (ramps()[..., axis].astype(np.uint16) for axis in (0, 1))
    write_png(tmp_path / "a.png", 1000 * v + u)
    picked = nearest(read_depth(tmp_path / "a.png"), SMALL)
    where = np.stack([picked % 1000, picked // 1000], axis=-1)
    assert np.abs(where - original_coordinates()).max() <= 0.5  # an even factor has no central pixel
    assert picked.dtype == np.uint16


def test_depth_and_classes_are_not_averaged(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    write_png(tmp_path / "d.png", rng.choice(np.array([0, 20000], np.uint16), SIZE))
    write_png(tmp_path / "c.png", rng.choice(np.array([0, 18, 255], np.uint8), SIZE))
    assert set(np.unique(nearest(read_depth(tmp_path / "d.png"), SMALL))) == {0, 20000}
    assert set(np.unique(nearest(read_classes(tmp_path / "c.png"), SMALL))) == {0, 18, 255}


@pytest.mark.parametrize("channels", [(3,), ()])
def test_same_size_is_lossless_and_grey_is_repeated(tmp_path: Path, channels: tuple[int, ...]) -> None:
    pixels = np.random.default_rng(0).integers(0, 256, (*SIZE, *channels), np.uint8)
    write_png(tmp_path / "a.png", pixels)
    image = read_image(tmp_path / "a.png", SIZE)
    np.testing.assert_array_equal(image, pixels if channels else np.repeat(pixels[..., None], 3, axis=-1))


rng = np.random.default_rng(0)
PIXELS = [
    rng.integers(0, 256, (20, 30, 3), np.uint8),
    rng.integers(0, 256, (20, 30), np.uint8),
    rng.integers(0, 65536, (20, 30), np.uint16),
]
SMOOTH = np.full((32, 48, 3), (200, 100, 50), np.uint8)


def encode_jpeg(*options: int) -> bytes:
    return cv2.imencode(".jpg", SMOOTH[..., ::-1], list(options))[1].tobytes()


@pytest.mark.parametrize("pixels", PIXELS)
def test_png_round_trip(tmp_path: Path, pixels: np.ndarray) -> None:
    write_png(tmp_path / "a.png", pixels)
    decoded = read_pixels(tmp_path / "a.png")
    np.testing.assert_array_equal(decoded, pixels)
    assert decoded.dtype == pixels.dtype


@pytest.mark.parametrize("options", [(), (cv2.IMWRITE_JPEG_PROGRESSIVE, 1)])
def test_jpeg(tmp_path: Path, options: tuple[int, ...]) -> None:
    (tmp_path / "a.jpg").write_bytes(encode_jpeg(*options) + b"\0maker's notes")
    assert np.abs(read_pixels(tmp_path / "a.jpg").astype(int) - SMOOTH).max() < 6


@pytest.mark.parametrize(
    ("content", "problem"),
    [(b"", "empty"), (b"GIF89a", "not a PNG or JPEG"), (b"\xff\xd8\xff\xd9", "decoded"), (None, "4 channels")],
)
def test_other_content(tmp_path: Path, content: bytes | None, problem: str) -> None:
    transparent = cv2.imencode(".png", np.zeros((8, 8, 4), np.uint8))[1].tobytes()
    (tmp_path / "a").write_bytes(transparent if content is None else content)
    with pytest.raises(DamagedFile, match=problem):
        read_pixels(tmp_path / "a")
