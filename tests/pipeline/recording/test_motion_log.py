"""CSV logs: columns in any order; faults are refused in one line."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from pipeline.base.errors import InputError
from pipeline.recording.motion_log import read_gpx, read_motion, read_nmea, read_wheel
from pipeline.recording.track import rates_of
from tests.gnss import START, bend, gpx, nmea, sentence

HEAD = "time_s,speed_mps,yaw_rate_radps\n"


def log(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "can.csv"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize(
    "text",
    [
        HEAD + "1,5,0.1\n1.5,6,-0.2\n",
        "yaw_rate_radps, note, time_s, speed_mps\n0.1, \"a, b\", 1, 5\n-0.2,, 1.5, 6\n\n",
        "\ufeffspeed_mps;time_s;yaw_rate_radps\r\n5;1;0.1\r\n6;1.5;-0.2\r\n",
    ],
)  # fmt: skip
def test_columns_are_found_by_name(tmp_path: Path, text: str) -> None:
    motion = read_motion(log(tmp_path, text), offset_s=10)
    np.testing.assert_array_equal(motion.time_s, [11, 11.5])
    np.testing.assert_array_equal(motion.speed_mps, [5, 6])
    np.testing.assert_array_equal(motion.yaw_rate_radps, [0.1, -0.2])
    assert motion.source == f"2 samples of {tmp_path}/can.csv"


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("", "no column time_s, speed_mps, yaw_rate_radps"),
        ("time_s,v\n1,2\n", r"no column speed_mps, yaw_rate_radps \(got time_s, v\)"),
        (HEAD + "1,1e6,0\n2,5,0\n", r"speed_mps = 1e\+06 at sample 1"),
        (HEAD + "1,5,0\n1e18,5,0\n", "time_s = 1e.18 at sample 2"),
        (HEAD + "1,5,0\n3,5,0\n3,5,0\n", "from 3 to 3 at sample 3"),
        (HEAD + '1,5,0\n2,"5,0\n3,5,0\n', "not a table of numbers"),
    ],
)
def test_faults_of_a_log(tmp_path: Path, text: str, problem: str) -> None:
    with pytest.raises(InputError, match=problem) as raised:
        read_motion(log(tmp_path, text))
    assert raised.value.where == str(tmp_path / "can.csv")
    assert "\n" not in str(raised.value).strip()


def test_files_that_are_no_log(tmp_path: Path) -> None:
    (tmp_path / "drive.mp4").write_bytes(b"\0\0\0 ftypisom")
    with (tmp_path / "sparse.csv").open("wb") as file:
        file.write((HEAD + "0,5,0\n" * 1000).encode())
        file.truncate(3 << 30)
    for name, problem in (("", "regular"), ("none.csv", "regular"), ("drive.mp4", "text"), ("sparse.csv", "too large")):
        with pytest.raises(InputError, match=problem):
            read_motion(tmp_path / name)


def test_tracks_are_recognised(tmp_path: Path) -> None:
    time_s, places, heading = bend(20, 1.0)
    for text, rule in (
        (gpx(time_s, places), "from positions, fitted by parabolas over 5 fixes"),
        (nmea(time_s, places, 9.0, heading), "from velocities, fitted by parabolas over 3 fixes"),
    ):
        motion = read_motion(log(tmp_path, text), offset_s=-START.timestamp())
        np.testing.assert_allclose(motion.time_s, time_s, atol=1e-6)
        assert rule in motion.source
    year_1 = gpx(time_s, places).replace(">2027-", ">0001-")
    with pytest.raises(InputError, match="time_s = -6"):
        read_motion(log(tmp_path, year_1))


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("frame,wheel_rad\n0,0\n1e300,0\n", "frame = 1e.300"),
        ("frame,wheel_rad\n0,0\n0.5,0\n", r"frame = 0.5 at sample 2 \(expected integers"),
        ("frame,wheel_rad\n-1,0\n2,0\n", "frame = -1"),
        ("frame,wheel_rad\n2,0\n1,0\n", "frame goes from 2 to 1"),
        ("frame,wheel_rad\n1,0\n2,900\n", "steering_rad = 60"),
        ("time_s,wheel_rad\n1,0\n1.000000001,0\n", "time_s goes from"),
        ("wheel_rad\n1\n2\n", "neither frame nor time_s"),
    ],
)
def test_faults_of_a_wheel_log(tmp_path: Path, text: str, problem: str) -> None:
    with pytest.raises(InputError, match=problem) as raised:
        read_wheel(log(tmp_path, text), 15.0)
    assert raised.value.where == str(tmp_path / "can.csv")


@pytest.fixture
def track(tmp_path: Path) -> Callable[[str], Path]:
    def write(text: str) -> Path:
        path = tmp_path / "track"
        path.write_text(text)
        return path

    return write


def test_gpx_points(track: Callable[[str], Path]) -> None:
    time_s, places, _ = bend(6, 0.5)
    fixes = read_gpx(track(gpx(time_s, places)))
    np.testing.assert_allclose(fixes.time_s, START.timestamp() + time_s)
    np.testing.assert_allclose(fixes.latitude_deg, places[:, 0], atol=1e-9)
    np.testing.assert_allclose(fixes.longitude_deg, places[:, 1], atol=1e-9)
    assert fixes.velocity_mps is None


def test_nmea_sentences(track: Callable[[str], Path]) -> None:
    time_s, places, heading = bend(6, 0.25)
    text = nmea(time_s, places, 9.0, heading)
    damaged = text.splitlines()[2].replace("A,4900", "A,4800")
    without_fix = sentence("GPGGA,100000,4900.0,N,00824.0,E,1,08,0.9,545.4,M,46.9,M,,") + sentence(
        "GNRMC,,V,,,,,,,,,,N"
    )
    fixes = read_nmea(track(f"{without_fix}{text}{damaged}\n$GNRMC,garbage\n"))
    np.testing.assert_allclose(fixes.time_s, START.timestamp() + time_s)
    np.testing.assert_allclose(np.stack([fixes.latitude_deg, fixes.longitude_deg], -1), places, atol=1e-8)
    velocity = 9 * np.stack([np.cos(heading), np.sin(heading)], axis=-1)
    np.testing.assert_allclose(fixes.velocity_mps, velocity, atol=1e-3)


def test_a_stop_in_a_bend(track: Callable[[str], Path]) -> None:
    """The course is unknown while the car creeps; that is no turn to the north and back."""
    time_s = np.arange(200) / 10
    speed = np.clip(np.abs(time_s - 10) * 1.5 - 2, 0.3, 8)
    heading = np.pi + 0.05 * (np.cumsum(speed) - speed) / 10  # radius 20 m
    places = np.tile([49.0, 8.4], (200, 1))
    rates = rates_of(read_nmea(track(nmea(time_s, places, speed, heading))), Path("track"))
    moving = rates.speed_mps >= 1
    inner = moving & (np.abs(time_s - 10) < 9)
    assert 60 < inner.sum() < inner.size - 20
    np.testing.assert_allclose(rates.yaw_rate_radps[inner], 0.05 * speed[inner], atol=0.03)
