"""PNG files: a damaged one is never taken for a picture."""

from pathlib import Path

import numpy as np
import pytest
from pipeline.camera.png import read_png

from pipeline.base.errors import DamagedFile
from tests.kitti_drive import write_png

rng = np.random.default_rng(0)


@pytest.mark.parametrize(
    "pixels",
    [
        rng.integers(0, 256, (20, 30, 3), np.uint8),
        rng.integers(0, 256, (20, 30), np.uint8),
        rng.integers(0, 65536, (20, 30), np.uint16),
    ],
)
def test_reads_what_was_written(tmp_path: Path, pixels: np.ndarray) -> None:
    write_png(tmp_path / "a.png", pixels)
    read = read_png(tmp_path / "a.png")
    np.testing.assert_array_equal(read, pixels)
    assert read.dtype == pixels.dtype


def test_cut_at_any_byte(tmp_path: Path) -> None:
    path = tmp_path / "a.png"
    write_png(path, rng.integers(0, 256, (16, 16, 3), np.uint8))
    whole = path.read_bytes()
    for size in range(len(whole)):
        path.write_bytes(whole[:size])
        with pytest.raises(DamagedFile, match=r"is empty|not a PNG|cut short"):
            read_png(path)


def test_any_flipped_byte(tmp_path: Path) -> None:
    path = tmp_path / "a.png"
    write_png(path, rng.integers(0, 256, (8, 8), np.uint8))
    whole = path.read_bytes()
    for at in range(len(whole)):
        path.write_bytes(whole[:at] + bytes([whole[at] ^ 0xFF]) + whole[at + 1 :])
        with pytest.raises(DamagedFile):
            read_png(path)


def test_sound_checksums_around_no_picture(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """A file that a broken writer made: each chunk is as it was meant, but there are no pixels."""
    path = tmp_path / "a.png"
    write_png(path, rng.integers(0, 256, (8, 8), np.uint8))
    whole = path.read_bytes()
    at = whole.index(b"IDAT") - 4
    path.write_bytes(whole[:at] + whole[whole.index(b"IEND") - 4 :])
    with pytest.raises(DamagedFile, match="not a grey or RGB image"):
        read_png(path)


def test_transparency_is_refused(tmp_path: Path) -> None:
    import cv2

    cv2.imwrite(str(tmp_path / "a.png"), np.zeros((8, 8, 4), np.uint8))
    with pytest.raises(DamagedFile, match="not a grey or RGB image"):
        read_png(tmp_path / "a.png")
