"""The fit of the steering wheel's angle to measured motion, the table, and the drives cut out of one."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks import udacity
from pipeline.base.errors import InputError
from pipeline.kitti import steering_file


def motion() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    time_s = np.arange(600) / 10
    return time_s, 0.2 * np.sin(time_s / 3), 15 + 4 * np.sin(time_s / 7)


def test_the_four_constants_are_found() -> None:
    wheel = udacity.Wheel(gain=42.0, understeer=0.003, offset_rad=0.02, lag_s=0.1)
    true_rad = wheel.angle(*motion())
    found = udacity.fit(*motion(), true_rad)
    assert found == pytest.approx(wheel, rel=1e-3, abs=1e-3)
    assert found.angle(*motion()) == pytest.approx(true_rad, abs=1e-6)


def test_the_lag_is_the_delay_of_the_motion_behind_the_wheel() -> None:
    time_s, yaw_rate_radps, speed_mps = motion()
    earlier = np.interp(time_s + 0.2, time_s, yaw_rate_radps)  # a wheel that leads by two frames
    assert udacity.fit(time_s, yaw_rate_radps, speed_mps, 2 * earlier).lag_s == pytest.approx(0.2, abs=0.03)


def test_rows_are_sorted_by_their_error() -> None:
    wheel_rad = np.array([0.3, -0.4])
    table = udacity.table({"best": wheel_rad + 0.01, "zero": np.zeros(2), "worse": wheel_rad * 0.5}, wheel_rad)
    assert [line.split("|")[1].strip() for line in table.splitlines()[2:]] == ["zero", "worse", "best"]
    assert "| zero | 0.3536 |" in table


def test_no_labelled_frame_is_in_two_drives(tmp_path: Path) -> None:
    drive = tmp_path / "2016_11_17_drive_0001_sync"
    (drive / "image_02/data").mkdir(parents=True)
    (drive / "image_02/timestamps.txt").write_text("2016-11-17 12:00:00.000000000\n" * 1800)
    for frame in range(1800):
        (drive / f"image_02/data/{frame:010d}.png").touch()
    steering_file.write(drive / steering_file.FILE, {frame: frame / 1e4 for frame in range(1800)})
    udacity.split(drive)
    folders = udacity.split(drive)  # over the first ones
    labelled = [steering_file.read(folder / steering_file.FILE) for folder in folders]
    assert [frame for angles in labelled for frame in angles] == list(range(1800))
    assert all(angle == frame / 1e4 for angles in labelled for frame, angle in angles.items())
    images = [sorted(int(path.stem) for path in (folder / "image_02/data").iterdir()) for folder in folders]
    assert images == [list(range(1000)), list(range(1000, 1200)), list(range(1185, 1800))]


def test_a_drive_without_recorded_angles_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="--wheel"):
        udacity.split(tmp_path / "2016_11_17_drive_0001_sync")
