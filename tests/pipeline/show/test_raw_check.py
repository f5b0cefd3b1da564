"""Problems of raw drives."""

import os
from collections.abc import Callable
from pathlib import Path

import pytest

from pipeline.show import raw_check
from pipeline.show.raw_check import DriveCheck
from tests import kitti_drive

FRAMES = 20


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    folder = kitti_drive.write_drive(tmp_path / "kitti", frames=range(FRAMES))
    lines = (folder / "oxts/timestamps.txt").read_text().splitlines(keepends=True)
    (folder / "oxts/timestamps.txt").write_text("".join(lines[:FRAMES]))
    return folder


def check(folder: Path, deep: bool = False, cameras: tuple[int, ...] = (2, 0), lidar: bool = True) -> DriveCheck:
    return raw_check.check(folder, cameras, lidar, deep)


def image(folder: Path, frame: int) -> Path:
    return folder / f"image_02/data/{frame:010d}.png"


@pytest.mark.parametrize("deep", [False, True])
def test_complete_drive_has_no_problems(folder: Path, deep: bool) -> None:
    result = check(folder, deep)
    assert (result.problems, result.notes, result.fix) == ([], [], "")
    assert result.files == {"oxts": FRAMES, "image_02": FRAMES, "velodyne_points": FRAMES}
    assert result.calibration == ["cam_to_cam", "velo_to_cam"]


def empty(path: Path) -> None:
    path.write_bytes(b"")


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-5])


def make_pipe(path: Path) -> None:
    path.unlink()
    os.mkfifo(path)


@pytest.mark.parametrize("damage", [empty, cut, make_pipe])
@pytest.mark.parametrize("deep", [False, True])
def test_damaged_image(folder: Path, damage: Callable[[Path], None], deep: bool) -> None:
    damage(image(folder, 7))
    result = check(folder, deep)
    assert len(result.problems) == 1
    assert result.problems[0].startswith("image_02: frame 7 ")
    assert str(folder) not in result.problems[0]
    assert result.fix == f"unzip -o 2011_09_26_drive_0001_sync.zip '*/image_02/*' -d {folder.parent.parent}"
