from pathlib import Path

import numpy as np
import pytest

from pipeline.base.errors import DamagedFile, InputError
from pipeline.kitti.tolerant import TolerantReader

FILES = {3: Path("a"), 5: Path("damaged"), 6: Path("b")}


def read(path: Path) -> np.ndarray:
    if path.name == "damaged":
        raise DamagedFile(f"{path} is cut short")
    if path.name == "wrong":
        raise InputError("it has another size than the calibration says")
    return np.array([ord(path.name)])


def test_frames_go_by_their_place_and_damaged_ones_are_counted() -> None:
    reader = TolerantReader(tolerant=True)
    rows = [(row, array.item()) for row, array in reader.each("scan", read, FILES, [2, 3, 4, 5, 6])]
    assert rows == [(1, ord("a")), (4, ord("b"))]
    assert reader.damaged == {"scan": 1}


def test_a_damaged_frame_is_an_error_that_says_what_to_do() -> None:
    reader = TolerantReader(tolerant=False)
    with pytest.raises(DamagedFile, match=r"cut short\. Extract it again.* ingest\.on_damaged: skip"):
        list(reader.each("scan", read, FILES, [3, 5]))


def test_what_is_wrong_with_more_than_a_frame_is_never_tolerated() -> None:
    with pytest.raises(InputError, match="calibration"):
        list(TolerantReader(tolerant=True).each("image", read, {0: Path("wrong")}, [0]))
