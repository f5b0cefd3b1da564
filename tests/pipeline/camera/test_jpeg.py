"""JPEG files are read or refused, never half."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from pipeline.camera.jpeg import read_jpeg

from pipeline.base.errors import DamagedFile

IMAGE = np.full((32, 48, 3), (200, 100, 50), np.uint8)


def encoded(*options: int) -> bytes:
    return cv2.imencode(".jpg", IMAGE[..., ::-1], list(options))[1].tobytes()


@pytest.mark.parametrize("options", [(), (cv2.IMWRITE_JPEG_PROGRESSIVE, 1)])
def test_pixels(tmp_path: Path, options: tuple[int, ...]) -> None:
    (tmp_path / "a.jpg").write_bytes(encoded(*options) + b"\0maker's notes")
    assert np.abs(read_jpeg(tmp_path / "a.jpg").astype(int) - IMAGE).max() < 6


@pytest.mark.parametrize("options", [(), (cv2.IMWRITE_JPEG_PROGRESSIVE, 1)])
def test_cut_short(tmp_path: Path, options: tuple[int, ...]) -> None:
    preview = encoded()  # as cameras put one before the pixels
    (tmp_path / "a.jpg").write_bytes(preview + encoded(*options)[:-4])
    with pytest.raises(DamagedFile, match="is cut short at"):
        read_jpeg(tmp_path / "a.jpg")


@pytest.mark.parametrize(
    ("content", "message"), [(b"", "is empty"), (b"GIF89a", "not a JPEG"), (b"\xff\xd8\xff\xd9", "cannot be decoded")]
)
def test_not_a_jpeg(tmp_path: Path, content: bytes, message: str) -> None:
    (tmp_path / "a.jpg").write_bytes(content)
    with pytest.raises(DamagedFile, match=message):
        read_jpeg(tmp_path / "a.jpg")
