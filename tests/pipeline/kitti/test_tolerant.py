"""Damaged files of single frames."""

from pathlib import Path

import numpy as np
import pytest

from pipeline.base.errors import DamagedFile, InputError
from pipeline.kitti.tolerant import TolerantReader

FILES = {3: Path("a"), 5: Path("damaged"), 6: Path("b"), 9: Path("wrong")}


def read(path: Path) -> np.ndarray:
    if path.name == "damaged":
        raise DamagedFile("cut short", path)
    if path.name == "wrong":
        raise InputError("size differs from the calibration", path)
    return np.array([ord(path.name)])


def test_damaged_frames_are_skipped_and_counted() -> None:
    reader = TolerantReader(tolerant=True)
    rows = [(row, array.item()) for row, array in reader.each("scan", read, FILES, [2, 3, 4, 5, 6])]
    assert rows == [(1, ord("a")), (4, ord("b"))]
    assert reader.damaged == {"scan": 1}


def test_damaged_frame_is_an_error() -> None:
    with pytest.raises(DamagedFile) as raised:
        list(TolerantReader(tolerant=False).each("scan", read, FILES, [3, 5]))
    assert "ingest.on_damaged" in raised.value.fix


def test_faults_of_more_than_a_frame_are_never_tolerated() -> None:
    with pytest.raises(InputError, match="calibration"):
        list(TolerantReader(tolerant=True).each("image", read, FILES, [9]))
