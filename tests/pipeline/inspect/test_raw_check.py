"""Problems of raw drives, and the command that extracts them again."""

import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from pipeline.base.errors import InputError
from pipeline.inspect import raw_check
from pipeline.inspect.raw_check import DriveCheck
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


def cut_to_header(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:20])


def change_format(path: Path) -> None:
    path.write_bytes(b"JFIF" + path.read_bytes())


def flip_bit(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 8
    path.write_bytes(content)


def make_pipe(path: Path) -> None:
    path.unlink()
    os.mkfifo(path)


def link_to_device(path: Path) -> None:
    path.unlink()
    path.symlink_to("/dev/zero")


def link_to_nothing(path: Path) -> None:
    path.unlink()
    path.symlink_to("nothing")


@pytest.mark.parametrize("damage", [empty, cut, cut_to_header, make_pipe, link_to_device, link_to_nothing])
@pytest.mark.parametrize("deep", [False, True])
def test_damaged_image(folder: Path, damage: Callable[[Path], None], deep: bool) -> None:
    damage(image(folder, 7))
    result = check(folder, deep)
    assert len(result.problems) == 1
    assert result.problems[0].startswith("image_02: frame 7 ")
    assert str(folder) not in result.problems[0]
    assert result.fix == f"unzip -o 2011_09_26_drive_0001_sync.zip '*/image_02/*' -d {folder.parent.parent}"


@pytest.mark.parametrize("damage", [flip_bit, change_format])
def test_damage_that_is_found_by_decoding(folder: Path, damage: Callable[[Path], None]) -> None:
    damage(image(folder, 7))
    assert not check(folder).problems
    assert len(check(folder, deep=True).problems) == 1


@pytest.mark.parametrize("content", [b"1 2 3", b"nan " * 30, b"x " * 30, b"", b"1 " * 50_000])
def test_damaged_packet(folder: Path, content: bytes) -> None:
    (folder / "oxts/data/0000000003.txt").write_bytes(content)
    (problem,) = check(folder).problems
    assert problem.startswith("oxts: frame 3 ")


def test_damaged_scans_and_many_kinds_of_damage(folder: Path) -> None:
    for frame, count in enumerate([0, 1601, 1, 0, 1600]):
        path = folder / f"velodyne_points/data/{frame:010d}.bin"
        path.write_bytes(path.read_bytes()[:count])
    problems = check(folder).problems
    assert [problem.split(" is ")[0] for problem in problems] == [
        "velodyne_points: frame 0, 3", "velodyne_points: frame 1, 2",
    ]  # fmt: skip
    packets = ["1", "1 2", "1 2 3", "1 2 3 4", "1 2 3 4 5"]
    for frame, text in enumerate(packets):
        (folder / f"oxts/data/{frame:010d}.txt").write_text(text)
    oxts = [problem for problem in check(folder).problems if problem.startswith("oxts")]
    assert len(oxts) == 4
    assert oxts[3].startswith("oxts: frame 3, 4")


def test_partly_extracted_archive_is_a_problem_and_single_frames_are_a_note(folder: Path) -> None:
    image(folder, 4).unlink()
    result = check(folder)
    assert (result.problems, result.notes) == ([], ["image_02: 1 of 20 frames are missing: 4"])
    for frame in range(10, FRAMES):
        image(folder, frame).unlink()
    assert check(folder).problems == ["image_02: 11 of 20 frames are missing: 4, 10-19"]
    for frame in range(FRAMES):
        image(folder, frame).unlink(missing_ok=True)
    assert check(folder).problems == ["image_02: no files, archive not extracted"]
    (folder / "image_02/data").rmdir()
    assert len(check(folder).problems) == 1
    (folder / "image_02").rmdir()
    assert check(folder).problems == []  # a drive without images


def test_timestamps_give_the_number_of_frames(folder: Path) -> None:
    for frame in range(12, FRAMES):
        for path in folder.glob(f"*/data/{frame:010d}.*"):
            path.unlink()
    problems = check(folder).problems
    assert problems[0] == "oxts: 8 of 20 frames are missing: 12-19"
    assert len(problems) == 3


def test_excerpt_of_a_longer_drive_is_complete(tmp_path: Path) -> None:
    folder = kitti_drive.write_drive(tmp_path, frames=range(40, 50))
    lines = (folder / "oxts/timestamps.txt").read_text().splitlines(keepends=True)
    (folder / "oxts/timestamps.txt").write_text("".join(lines[:10]))
    result = check(folder)
    assert (result.problems, result.notes) == ([], [])


def test_missing_packets_or_timestamps(folder: Path) -> None:
    (folder / "oxts/timestamps.txt").write_text("now\n" * FRAMES)
    assert "'now'" in check(folder).problems[0]
    (folder / "oxts/timestamps.txt").unlink()
    (problem,) = check(folder).problems
    assert "timestamps.txt" in problem
    for path in (folder / "oxts/data").iterdir():
        path.unlink()
    assert check(folder).problems == ["oxts: no files, archive not extracted"]
    (folder / "oxts/data").rmdir()
    (folder / "oxts").rmdir()
    assert check(folder).problems == ["oxts: folder is missing"]
    (problem,) = raw_check.check(folder, (2, 0), True, False, oxts=False).problems
    assert "image_02/timestamps.txt" in problem
    (folder / "image_02/timestamps.txt").write_text(
        "".join(f"2011-09-26 13:02:{second}\n" for second in range(10, 10 + FRAMES))
    )
    assert raw_check.check(folder, (2, 0), True, False, oxts=False).problems == []


@pytest.mark.parametrize("name", ["calib_cam_to_cam.txt", "calib_velo_to_cam.txt"])
@pytest.mark.parametrize("content", [None, "", "no calibration", "\xff\xfe", "R: 1\n" * 300_000])
def test_unusable_calibration(folder: Path, name: str, content: str | None) -> None:
    path = folder.parent / name
    if content is None:
        path.unlink()
    else:
        path.write_bytes(content.encode("latin-1"))
    result = check(folder)
    assert len(result.problems) == 1
    assert result.problems[0].startswith("calibration: ")
    assert result.fix == f"unzip -o 2011_09_26_calib.zip -d {folder.parent.parent}"


def test_two_files_of_one_frame(folder: Path) -> None:
    image(folder, 3).with_name("3.png").write_bytes(b"")
    (problem,) = check(folder).problems
    assert "3.png" in problem


def test_modalities_that_the_project_does_not_use_give_notes(folder: Path) -> None:
    kitti_drive.write_png(folder / "image_03/data/0000000000.png", np.zeros((4, 4, 3), np.uint8))
    for path in (folder / "velodyne_points/data").iterdir():
        empty(path)
    result = check(folder, lidar=False)
    assert result.problems == []
    assert {note.partition(":")[0] for note in result.notes} == {"image_03", "velodyne_points"}
    assert "cameras [2, 3] only" in check(folder, cameras=(1,)).problems[-1]


def test_drive_for_labels_only(tmp_path: Path) -> None:
    result = check(kitti_drive.write_drive(tmp_path, camera=None, lidar=False))
    assert "only labels" in result.notes[-1]


def test_roots(folder: Path, tmp_path: Path) -> None:
    for root in (folder.parent.parent, folder.parent, folder):
        assert [result.drive for result in raw_check.check_root(root, (2,), True, False)] == [kitti_drive.DRIVE]
    for root, fix in ((tmp_path, f"Pass {tmp_path}/kitti"), (tmp_path / "none", "Expected <date>")):
        with pytest.raises(InputError, match="holds no drives") as raised:
            raw_check.check_root(root, (2,), True, False)
        assert raised.value.fix.startswith(fix)
