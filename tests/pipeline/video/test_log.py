"""Logs of motion and of the steering wheel: columns in any order, interpolation, and plainly wrong files."""

from pathlib import Path

import numpy as np
import pytest

from pipeline.base.errors import InputError
from pipeline.video.log import interpolate, read_motion, read_wheel

HEAD = "time_s,speed_mps,yaw_rate_radps\n"


def log(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "can.csv"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize(
    "text",
    [
        HEAD + "1,5,0.1\n1.5,6,-0.2\n",
        HEAD + "1,5,0.1,\n1.5,6,-0.2, ,\n",  # empty fields are no values
        "yaw_rate_radps, note, time_s, speed_mps\n0.1, \"a, b\", 1, 5\n-0.2,, 1.5, 6\n\n",
        "\ufeffspeed_mps;time_s;yaw_rate_radps\r\n5;1;0.1\r\n6;1.5;-0.2\r\n",
    ],
)  # fmt: skip
def test_columns_are_found_by_name(tmp_path: Path, text: str) -> None:
    motion = read_motion(log(tmp_path, text), offset_s=10)
    np.testing.assert_array_equal(motion.time_s, [11, 11.5])
    np.testing.assert_array_equal(motion.speed_mps, [5, 6])
    np.testing.assert_array_equal(motion.yaw_rate_radps, [0.1, -0.2])


WHEEL = "frame,wheel_rad\n"


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        (HEAD + "1,5,0\n2,1e6,0\n", r"speed_mps = 1e\+06 at sample 2"),
        (HEAD + "1,5,0\n3,5,0\n3,5,0\n", "from 3 to 3 at sample 3"),
        (HEAD + "0,5,0\n100,5,0\n", "divide milliseconds by 1000"),
        (HEAD + "0,5,0\n1e-4,5,0\n", "in seconds"),
        (HEAD + "0,5,0\n0,5,5,0\n", "line 3: has 4 values, the header 3 names. .*decimal point"),
        ("time_s;speed_mps;yaw_rate_radps\n0,1;5;0\n", "line 2: expected numbers"),
        (WHEEL + "1,-0,90\n2,-0,80\n", "line 2: has 3 values, the header 2 names. .*decimal point"),
        (WHEEL + "1,0\n2,45\n", "steering_rad = 3 "),
        ("time_s,wheel_rad\n0,0\n1000,0\n", "divide milliseconds"),
        ("wheel_rad\n0\n1\n", "neither time_s nor frame"),
    ],
)
def test_plainly_wrong_logs(tmp_path: Path, text: str, problem: str) -> None:
    path = log(tmp_path, text)
    with pytest.raises(InputError, match=problem) as raised:
        read_wheel(path, 15.0) if "wheel_rad" in text else read_motion(path)
    assert raised.value.where.startswith(str(path))


def test_times_count_before_frames(tmp_path: Path) -> None:
    """A 20 Hz log of a 10 Hz video, whose column `frame` numbers the samples."""
    angles = np.linspace(0, 3, 20)
    rows = "".join(f"{sample},{sample / 20},{angle!r}\n" for sample, angle in enumerate(angles.tolist()))
    wheel = read_wheel(log(tmp_path, "frame,time_s,wheel_rad\n" + rows), 10.0)
    number = np.arange(10)
    np.testing.assert_allclose(wheel.at(number, number / 10, 1.0), angles[::2] / 10)


def test_frames_count_images(tmp_path: Path) -> None:
    wheel = read_wheel(log(tmp_path, "frame;wheel_rad\n2;0.5\n4;1.5\n"), 10.0)
    np.testing.assert_array_equal(
        wheel.at(np.arange(6), np.arange(6) / 10, 1.0), [np.nan] * 2 + [0.05, np.nan, 0.15, np.nan]
    )
    wheel.check_frames(4)
    with pytest.raises(InputError, match="has frame 4, but the last image is 3"):
        wheel.check_frames(3)


def test_interpolation_ends_at_gaps_and_at_the_ends() -> None:
    samples_s = np.array([0.0, 0.5, 1.0, 4.0, 5.0])
    time_s = np.array([-0.01, -0.0005, 0.25, 1.0, 2.0, 4.0, 4.5, 5.0 + 1e-15, 5.01])
    expected = [np.nan, 0, 0.25, 1, np.nan, 4, 4.5, 5, np.nan]
    np.testing.assert_allclose(interpolate(time_s, samples_s, samples_s, max_gap_s=1.0), expected)
