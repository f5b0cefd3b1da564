"""PNG and JPEG files are decoded completely or refused."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from pipeline.base.errors import DamagedFile
from pipeline.camera.pixels import read_pixels, write_png

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
