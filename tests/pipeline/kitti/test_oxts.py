"""Packets and timestamps of KITTI's inertial unit."""

from pathlib import Path

import numpy as np
import pytest

from pipeline.base.errors import DamagedFile, InputError
from pipeline.kitti import oxts
from tests.kitti_drive import write


def test_columns_equal_pykittis() -> None:
    from pykitti.utils import OxtsPacket

    assert OxtsPacket._fields == oxts.COLUMNS
    assert (oxts.VF, oxts.VL, oxts.WU) == (8, 9, 22)


def test_packet_round_trip(tmp_path: Path) -> None:
    row = np.random.default_rng(0).normal(size=30)
    row[oxts.COLUMNS.index("navstat") :] = [4, 9, 4, 4, 4]
    (tmp_path / "0.txt").write_bytes(oxts.format_packet(row))
    np.testing.assert_allclose(oxts.read_row(tmp_path / "0.txt"), row, rtol=1e-12)


def test_times_round_trip(tmp_path: Path) -> None:
    time_s = np.array([0.0, 0.109958171, 0.2, 60000.0])
    (tmp_path / "a.txt").write_bytes(oxts.format_times(time_s, "2027_03_31", 8 * 3600))
    assert (tmp_path / "a.txt").read_text().splitlines()[1] == "2027-03-31 08:00:00.109958171"
    np.testing.assert_array_equal(oxts.read_times(tmp_path / "a.txt", [0, 1, 2]), time_s[:3])


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("", "got 0"),
        ("1.0 " * 29, "got 29"),
        ("1.0 " * 29 + "1.0.0", "expected numbers"),
        ("1.0 " * 22 + "nan " + "1.0 " * 7, "wu = nan"),
        ("1.0 " * 8 + "-1e300 " + "1.0 " * 21, "vf = -1e"),
    ],
)
def test_damaged_packet(tmp_path: Path, text: str, problem: str) -> None:
    write(tmp_path / "7.txt", text)
    with pytest.raises(DamagedFile, match=problem) as raised:
        oxts.read_row(tmp_path / "7.txt")
    assert raised.value.where == str(tmp_path / "7.txt")


def stamps(path: Path, seconds: list[str]) -> Path:
    write(path, "".join(f"2011-09-26 13:02:{text}\n" if text else "\n" for text in seconds))
    return path


@pytest.mark.parametrize(
    ("lines", "frames", "expected"),
    [
        (["25.0", "25.1", "25.25", "25.3", "25.45"], [1, 2, 4], [0, 0.15, 0.35]),  # by number
        (["25.0", "25.1", "25.3"], [100, 101, 103], [0, 0.1, 0.3]),  # cut out of a longer drive: by position
        (["25.0", "", "25.2"], [0, 2], [0, 0.2]),  # the empty line belongs to no frame
    ],
)
def test_lines_and_frames(tmp_path: Path, lines: list[str], frames: list[int], expected: list[float]) -> None:
    path = stamps(tmp_path / "timestamps.txt", lines)
    np.testing.assert_allclose(oxts.read_times(path, frames), expected, atol=1e-12)


@pytest.mark.parametrize(
    ("lines", "problem"),
    [
        (["25.0", "25.1"], "got 2"),
        (["25.0", "25.2", "25.1"], "line 3: time goes from .*25.2' to .*25.1'"),
        (["25.0", "what", "25.1"], "expected times"),
    ],
)
def test_bad_times(tmp_path: Path, lines: list[str], problem: str) -> None:
    with pytest.raises(InputError, match=problem) as raised:
        oxts.read_times(stamps(tmp_path / "timestamps.txt", lines), [0, 1, 2])
    assert not isinstance(raised.value, DamagedFile)  # leaving out a frame would not help
    assert raised.value.fix
