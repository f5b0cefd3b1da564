"""A car's own log is read whatever its columns' order; what is wrong with it is said in one line."""

from pathlib import Path

import numpy as np
import pytest

from pipeline.base.errors import InputError
from pipeline.recording.motion_log import read_motion
from tests.gnss import START, bend, gpx, nmea


def log(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "can.csv"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize(
    "text",
    [
        "time_s,speed_mps,yaw_rate_radps\n1,5,0.1\n1.5,6,-0.2\n",
        "yaw_rate_radps, note, time_s, speed_mps\n0.1, \"a, b\", 1, 5\n-0.2,, 1.5, 6\n\n",
        "\ufeffspeed_mps;time_s;yaw_rate_radps\r\n5;1;0.1\r\n6;1.5;-0.2\r\n",
    ],
)  # fmt: skip
def test_columns_are_found_by_their_names(tmp_path: Path, text: str) -> None:
    motion = read_motion(log(tmp_path, text), offset_s=10)
    np.testing.assert_array_equal(motion.rates.time_s, [11, 11.5])
    np.testing.assert_array_equal(motion.rates.speed_mps, [5, 6])
    np.testing.assert_array_equal(motion.rates.yaw_rate_radps, [0.1, -0.2])
    assert motion.source == f"2 samples of {tmp_path}/can.csv"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "no column time_s and no speed_mps and no yaw_rate_radps: its first line names nothing"),
        (
            "time_s,v\n1,2\n",
            r"no column speed_mps and no yaw_rate_radps: its first line names time_s, v; give time_s in",
        ),
        ("time_s,speed_mps,yaw_rate_radps\n1,5,0\n", "has 1 samples"),
        ("time_s,speed_mps,yaw_rate_radps\n1,5,0\n2,5\n", "line 3: .* are not three numbers"),
        ("time_s,speed_mps,yaw_rate_radps\n1,fast,0\n2,5,0\n", "line 2: .* are not three numbers"),
        ("time_s,speed_mps,yaw_rate_radps\n1,nan,0\n2,5,0\n", "line 2: .* are not three numbers"),
        ("time_s,speed_mps,yaw_rate_radps\n1,5,0\n3,5,0\n3,5,0\n", "from 3 to 3 at sample 3, it must increase"),
    ],
)
def test_what_is_wrong_with_a_log(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(InputError, match=message) as error:
        read_motion(log(tmp_path, text))
    assert str(tmp_path / "can.csv") in str(error.value)


def test_no_log(tmp_path: Path) -> None:
    for path in (tmp_path / "can.csv", tmp_path):
        with pytest.raises(InputError, match="is no file: --motion wants a CSV file with time_s in seconds"):
            read_motion(path)
    (tmp_path / "drive.mp4").write_bytes(b"\0\0\0 ftypisom")
    with pytest.raises(InputError, match="is not text: --motion wants a CSV file"):
        read_motion(tmp_path / "drive.mp4")


def test_tracks_are_told_by_how_they_begin(tmp_path: Path) -> None:
    time_s, places, heading = bend(20, 1.0)
    for text, rule in (
        (gpx(time_s, places), "positions, fitted by parabolas over 5 fixes"),
        (nmea(time_s, places, 9.0, heading), "velocities, fitted by parabolas over 3 fixes"),
    ):
        motion = read_motion(log(tmp_path, text), offset_s=-START.timestamp())
        np.testing.assert_allclose(motion.rates.time_s, time_s, atol=1e-6)
        assert f"20 fixes of {tmp_path}/can.csv: speed and course of its {rule}" in motion.source
