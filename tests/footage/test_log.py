"""Logs of a car: columns, faults, interpolation, and logs of another time than the images."""

from pathlib import Path

import numpy as np
import pytest

from footage import convert, video
from footage.log import Log, read_logs, read_times
from footage.settings import Options
from pipeline.base.errors import InputError
from tests.footage.videos import write_stream

HEAD = "time_s,speed_mps,yaw_rate_radps\n"


def write_log(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "can.csv"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize(
    "text",
    [
        HEAD + "1,5,0.1\n1.5,6,-0.2\n",
        HEAD + "1,5,0.1,\n1.5,6,-0.2, ,\n",  # empty fields are no values
        HEAD + "1,5,0.1\n1.2,NaN,None\n1.3,NA,null\n1.4,nan,\n1.5,6,-0.2,None\n",
        'yaw_rate_radps, note, time_s, speed_mps\n0.1, "a, b", 1, 5\n-0.2,, 1.5, 6\n\n',
        "\ufeffspeed_mps;time_s;yaw_rate_radps\r\n5;1;0.1\r\n6;1.5;-0.2\r\n",
    ],
)
def test_columns_are_found_by_name(tmp_path, text):
    path = write_log(tmp_path, text)
    logs = read_logs(Options(motion=path, offset=10))
    for name, values in {"speed_mps": [5, 6], "yaw_rate_radps": [0.1, -0.2]}.items():
        np.testing.assert_array_equal(logs[name].time_s, [11, 11.5])
        np.testing.assert_array_equal(logs[name].values, values)


WHEEL = "time_s,wheel_rad\n"


def read_log(path: Path, text: str) -> object:
    """Read a file with this text: a log of the wheel, or of the motion, or times of images."""
    if "wheel_rad" in text:
        return read_logs(Options(wheel=path, steering_ratio=15.0))
    if "yaw_rate" in text:
        return read_logs(Options(motion=path))
    return read_times(path)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        (HEAD + "1,5,0\n1.1,1e6,0\n", r"speed_mps is implausible \(limit ±100\): '1e6' in line 3"),
        (HEAD + "1,5,0\n1.3,5,0\n\n1.3,6,0\n", "time_s does not increase .*: 1.3 in line 5"),
        (HEAD + "0,5,0\n100,5,0\n", "divide milliseconds by 1000"),
        (HEAD + "17e17,5,0\n170000000010e7,5,0\n", r"nanoseconds by 1e9; .*: 1.7e\+18 in line 2\."),
        (HEAD + "0,5,0\n0,5,5,0\n", "cell 4 has no name in line 1: '0' in line 3.*decimal points"),
        ("time_s;speed_mps;yaw_rate_radps\n0,1;5;0\n", "time_s is not a number: '0,1' in line 2"),
        (
            HEAD + "0,x,0\n2,999,0\n1,5,9\n",
            "'x' in line 2; speed.*999.*line 3; yaw.*'9' in line 4; time.*1.0 in",
        ),
        (HEAD + '"0,5,0\n', "is not a CSV file"),
        (HEAD + "NaN,5,0\n1,N,0\n", "time_s is not a number: 'NaN' in line 2; speed_mps is.*'N'"),
        (WHEEL + "1,0\n1.1,45\n", "wheel_rad is implausible .*: '45' in line 3"),
        ("sep=;\n" + WHEEL, r"has no column time_s, wheel_rad \(got sep=, \)"),
        (WHEEL, "wheel_rad has fewer than 2 values"),
        ("1\n2\n2\n", "time does not increase .*: 2.0 in line 3"),
        ("0\n100\nx\n", "'x' in line 3; time has a median step .*divide milliseconds by 1000"),
    ],
)
def test_plainly_wrong_logs(tmp_path, text, problem):
    path = write_log(tmp_path, text)
    with pytest.raises(InputError, match=problem):
        read_log(path, text)


def test_interpolation_ends_at_gaps_and_at_the_ends():
    known_s = np.array([0.0, 0.5, 1.0, 1.6, 2.0])
    time_s = np.array([-0.01, -0.0005, 0.25, 1.0, 1.3, 1.6, 1.8, 2.0 + 1e-15, 2.01])
    expected = [np.nan, 0, 0.25, 1, np.nan, 1.6, 1.8, 2, np.nan]
    np.testing.assert_allclose(Log(known_s, known_s).interpolate(time_s), expected)


def test_two_topics_in_one_log_have_their_own_times(tmp_path):
    """Also with a repeated row. The yaw rate has a gap of 0.6 s."""
    speed = [f"{time_s},{10 * time_s}," for time_s in (0.1, 0.3, 0.7)]
    yaw_rate = [f"{time_s},,{time_s}" for time_s in (0.05, 0.25, 0.85)]
    rows = [*speed, *yaw_rate, speed[0]]
    logs = read_logs(Options(motion=write_log(tmp_path, HEAD + "\n".join(rows))))
    time_s = np.array([0.05, 0.2, 0.4])
    np.testing.assert_allclose(logs["speed_mps"].interpolate(time_s), [np.nan, 2, 4])
    np.testing.assert_allclose(logs["yaw_rate_radps"].interpolate(time_s), [0.05, 0.2, np.nan])


@pytest.mark.parametrize(
    ("options", "problem"),
    [({"wheel": "wheel.csv"}, "--steering-ratio"), ({"offset": 1}, "--offset needs a log")],
)
def test_options_that_belong_together(options, problem):
    with pytest.raises(InputError, match=problem):
        read_logs(Options(**options))


def test_a_log_of_another_time_is_refused_before_images_are_decoded(tmp_path, monkeypatch):
    """A tenth of a second in common suffices."""
    path = write_stream(tmp_path / "a.mkv")
    rows = "".join(f"{7200 + number / 10:.1f},5,0\n" for number in range(20))
    motion = write_log(tmp_path, HEAD + rows)
    monkeypatch.setattr(video, "_decode_frames", None)
    for offset_s, expected in ((0, -7200), (-7202, 2)):
        problem = rf"the images from 0.0 to 2.9 s\. .*pass --offset {expected},"
        with pytest.raises(InputError, match=problem):
            convert.open_recording([path], Options(motion=motion, offset=offset_s))
    # Files may have gaps, so no offset fits all of them.
    other = write_stream(tmp_path / "b.mkv")
    with pytest.raises(InputError, match=r"to 5\.9 s\. Pass --times FILE"):
        convert.open_recording([path, other], Options(motion=motion))
    for offset_s in (-7201.8, -7197.2):
        convert.open_recording([path], Options(motion=motion, offset=offset_s))
