"""The drives for training, validation and testing, cut out of one."""

from pathlib import Path

import pytest

from benchmarks import udacity_drives
from pipeline.base.errors import InputError
from pipeline.kitti.raw import STEERING_FILE
from pipeline.labels import steering_file


def test_no_labelled_frame_is_in_two_drives(tmp_path: Path) -> None:
    drive = tmp_path / "2016_11_17_drive_0001_sync"
    (drive / "image_02/data").mkdir(parents=True)
    (drive / "image_02/timestamps.txt").write_text("2016-11-17 12:00:00.000000000\n" * 1800)
    for frame in range(1800):
        (drive / f"image_02/data/{frame:010d}.png").touch()
    steering_file.write(drive / STEERING_FILE, {frame: frame / 1e4 for frame in range(1800)})
    udacity_drives.main(drive)
    folders = udacity_drives.main(drive)  # over the first ones
    labelled = [steering_file.read(folder / STEERING_FILE) for folder in folders]
    assert [frame for angles in labelled for frame in angles] == list(range(1800))
    assert all(angle == frame / 1e4 for angles in labelled for frame, angle in angles.items())
    images = [sorted(int(path.stem) for path in (folder / "image_02/data").iterdir()) for folder in folders]
    assert images == [list(range(1000)), list(range(1000, 1200)), list(range(1185, 1800))]


def test_a_drive_without_recorded_angles_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="--wheel"):
        udacity_drives.main(tmp_path / "2016_11_17_drive_0001_sync")
