"""Packets and timestamps of KITTI's inertial unit."""

from pathlib import Path

import numpy as np
import pytest

from pipeline.base.errors import DamagedFile, InputError
from pipeline.kitti import oxts
from tests.kitti_drive import write


def test_columns_are_pykittis() -> None:
    from pykitti.utils import OxtsPacket

    assert OxtsPacket._fields == oxts.COLUMNS
    assert (oxts.VF, oxts.VL, oxts.WU) == (8, 9, 22)


def test_row_reads_what_was_written(tmp_path: Path) -> None:
    row = np.random.default_rng(0).normal(size=30)
    write(tmp_path / "0.txt", " ".join(repr(float(x)) for x in row))
    np.testing.assert_array_equal(oxts.read_row(tmp_path / "0.txt"), row)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "has 0 of 30"),
        ("1.0 " * 29, "has 29 of 30"),
        ("1.0 " * 31, "has 31 of 30"),
        ("1.0 " * 29 + "1.0.0", "not a number"),
        ("1.0 " * 22 + "nan " + "1.0 " * 7, "wu is nan"),
        ("1.0 " * 8 + "inf " + "1.0 " * 21, "vf is inf"),
        ("\0" * 300, "has 1 of 30"),
    ],
)
def test_damaged_row(tmp_path: Path, text: str, message: str) -> None:
    write(tmp_path / "7.txt", text)
    with pytest.raises(DamagedFile, match=message) as error:
        oxts.read_row(tmp_path / "7.txt")
    assert str(tmp_path / "7.txt") in str(error.value)


def stamps(path: Path, seconds: list[str]) -> Path:
    write(path, "".join(f"2011-09-26 13:02:{text}\n" if text else "\n" for text in seconds))
    return path


def test_line_belongs_to_frame_of_that_number(tmp_path: Path) -> None:
    path = stamps(tmp_path / "timestamps.txt", ["25.0", "25.1", "25.25", "25.3", "25.45"])
    np.testing.assert_allclose(oxts.read_times(path, [1, 2, 4]), [0, 0.15, 0.35], atol=1e-12)


def test_times_keep_nanoseconds(tmp_path: Path) -> None:
    path = stamps(tmp_path / "timestamps.txt", ["25.964389445", "26.074347616"])
    assert oxts.read_times(path, [0, 1])[1] == 0.109958171


def test_drive_cut_out_of_a_longer_one_goes_by_position(tmp_path: Path) -> None:
    path = stamps(tmp_path / "timestamps.txt", ["25.0", "25.1", "25.3"])
    np.testing.assert_allclose(oxts.read_times(path, [100, 101, 103]), [0, 0.1, 0.3], atol=1e-12)


def test_empty_line_of_a_frame_that_is_not_there_does_not_matter(tmp_path: Path) -> None:
    path = stamps(tmp_path / "timestamps.txt", ["25.0", "", "25.2"])
    np.testing.assert_allclose(oxts.read_times(path, [0, 2]), [0, 0.2], atol=1e-12)


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        (["25.0", "25.1"], "has 2 lines, frame 2 needs line 3"),
        (["25.0", "", "25.2"], "empty at line 2"),
        (["25.0", "25.2", "25.1"], "time goes from .*25.2.* to .*25.1.* at line 3"),
        (["25.0", "25.1", "25.1"], "at line 3, it must increase"),
        (["25.0", "what", "25.1"], "not a time"),
    ],
)
def test_bad_times(tmp_path: Path, lines: list[str], message: str) -> None:
    with pytest.raises(InputError, match=message) as error:
        oxts.read_times(stamps(tmp_path / "timestamps.txt", lines), [0, 1, 2])
    assert not isinstance(error.value, DamagedFile)  # no single frame can be left out to mend it


def test_missing_times(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="is missing: extract"):
        oxts.read_times(tmp_path / "timestamps.txt", [0])
