"""A whole drive is well; whatever is missing or damaged is told, with the command that mends it."""

import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from pipeline.inspect import raw_check
from pipeline.inspect.raw_check import DriveCheck
from tests import kitti_drive

FRAMES = 20


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    made = kitti_drive.write_drive(tmp_path / "kitti", frames=range(FRAMES))
    lines = (made / "oxts/timestamps.txt").read_text().splitlines(keepends=True)
    (made / "oxts/timestamps.txt").write_text("".join(lines[:FRAMES]))
    return made


def check(folder: Path, deep: bool = False, cameras: tuple[int, ...] = (2, 0), lidar: bool = True) -> DriveCheck:
    return raw_check.check(folder, cameras, lidar, deep)


@pytest.mark.parametrize("deep", [False, True])
def test_a_whole_drive_is_well(folder: Path, deep: bool) -> None:
    found = check(folder, deep)
    assert (found.must, found.notes, found.advice(), found.frames) == ([], [], "", FRAMES)
    assert found.modalities["image_02"]["files"] == FRAMES


def image(folder: Path, frame: int) -> Path:
    return folder / f"image_02/data/{frame:010d}.png"


def empty(path: Path) -> None:
    path.write_bytes(b"")


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-5])


def cut_to_the_head(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:20])


def another_format(path: Path) -> None:
    path.write_bytes(b"JFIF" + path.read_bytes())


def another_size(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[16:20] = (65).to_bytes(4, "big")
    path.write_bytes(content)


def absurd_size(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[16:24] = (60_000).to_bytes(4, "big") * 2
    path.write_bytes(content)


def a_pipe(path: Path) -> None:
    path.unlink()
    os.mkfifo(path)


def a_device(path: Path) -> None:
    path.unlink()
    path.symlink_to("/dev/zero")


def a_link_to_nowhere(path: Path) -> None:
    path.unlink()
    path.symlink_to("nowhere")


@pytest.mark.parametrize(
    ("damage", "said"),
    [
        (empty, "is empty"),
        (cut, "is cut short"),
        (cut_to_the_head, "is cut short at 20 bytes"),
        (another_format, "is not a PNG file"),
        (another_size, "is 65 x 48 pixels, the calibration says 64 x 48"),
        (absurd_size, "says that it has 60000 x 60000 pixels"),
        (a_pipe, "is no plain file"),
        (a_device, "is no plain file"),
        (a_link_to_nowhere, "is no plain file"),
    ],
)
@pytest.mark.parametrize("deep", [False, True])
def test_a_damaged_image(folder: Path, damage: Callable[[Path], None], said: str, deep: bool) -> None:
    damage(image(folder, 7))
    found = check(folder, deep)
    assert len(found.must) == 1
    assert found.must[0].startswith("image_02: frame 7 ")
    assert said in found.must[0]
    root = folder.parent.parent
    assert found.advice() == f"unzip -o 2011_09_26_drive_0001_sync.zip '*/image_02/*' -d {root}"


def test_a_flipped_bit_is_seen_by_decoding(folder: Path) -> None:
    content = bytearray(image(folder, 7).read_bytes())
    content[len(content) // 2] ^= 8
    image(folder, 7).write_bytes(content)
    assert not check(folder).must
    assert "frame 7 is damaged: the checksum" in check(folder, deep=True).must[0]


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"1 2 3", "has 3 of 30 oxts columns"),
        (b"nan " * 30, "lat is nan"),
        (b"x " * 30, "not a number"),
        (b"", "is empty"),
        (b"1 " * 50_000, "far too many"),
    ],
)
def test_a_damaged_packet(folder: Path, content: bytes, said: str) -> None:
    (folder / "oxts/data/0000000003.txt").write_bytes(content)
    found = check(folder)
    assert len(found.must) == 1
    assert said in found.must[0]
    assert found.extract == {"oxts"}


def test_scans_of_odd_size_or_too_few_points(folder: Path) -> None:
    scans = folder / "velodyne_points/data"
    for frame, count in ((2, 1601), (5, 800), (6, 0)):
        path = scans / f"{frame:010d}.bin"
        path.write_bytes(path.read_bytes()[:count])
    found = check(folder)
    assert found.must == [
        "velodyne_points: frame 2 has 1601 bytes, no whole number of points", "velodyne_points: frame 6 is empty",
    ]  # fmt: skip
    assert found.notes == ["velodyne_points: scans of less than half the usual size: 5"]
    assert "frame 5 is damaged: of its 50 points" in check(folder, deep=True).must[1]


def test_half_an_archive_must_be_extracted_and_a_single_gap_is_kittis_own(folder: Path) -> None:
    image(folder, 4).unlink()
    found = check(folder)
    assert (found.must, found.notes) == ([], ["image_02 lacks 1 of 20 frames: 4"])
    for frame in range(10, FRAMES):
        image(folder, frame).unlink()
    found = check(folder)
    assert found.must == ["image_02 lacks 11 of 20 frames: 4, 10-19"]
    for frame in range(FRAMES):
        image(folder, frame).unlink(missing_ok=True)
    assert check(folder).must == ["image_02: nothing was extracted"]
    (folder / "image_02/data").rmdir()
    assert check(folder).must == ["image_02: nothing was extracted"]
    (folder / "image_02").rmdir()
    assert check(folder).must == []  # a drive without images


def test_packets_are_missed_by_the_lines_of_their_times(folder: Path) -> None:
    for frame in range(12, FRAMES):
        for path in folder.glob(f"*/data/{frame:010d}.*"):
            path.unlink()
    must = check(folder).must
    assert must[0] == "oxts lacks 8 of 20 frames: 12-19"
    assert len(must) == 3


def test_a_drive_that_was_cut_out_of_a_longer_one_is_whole(tmp_path: Path) -> None:
    folder = kitti_drive.write_drive(tmp_path, frames=range(40, 50))
    lines = (folder / "oxts/timestamps.txt").read_text().splitlines(keepends=True)
    (folder / "oxts/timestamps.txt").write_text("".join(lines[:10]))
    found = check(folder)
    assert (found.must, found.notes) == ([], [])


def test_without_packets_or_their_times_there_are_no_labels(folder: Path) -> None:
    (folder / "oxts/timestamps.txt").write_text("now\n" * FRAMES)
    assert "holds 'now', not a time, at line 1" in check(folder).must[0]
    (folder / "oxts/timestamps.txt").unlink()
    assert check(folder).must == [
        "oxts/timestamps.txt is missing: extract the drive's oxts folder with its timestamps.txt"
    ]
    for path in (folder / "oxts/data").iterdir():
        path.unlink()
    assert check(folder).must == ["oxts: nothing was extracted"]
    (folder / "oxts/data").rmdir()
    (folder / "oxts").rmdir()
    assert check(folder).must == ["oxts: its folder is missing"]


@pytest.mark.parametrize("name", ["calib_cam_to_cam.txt", "calib_velo_to_cam.txt"])
@pytest.mark.parametrize(
    "content", [None, "", "no calibration", "\xff\xfe", "P_rect_02: 0 0 0 0 0 0 0 0 0 0 0 0\n", "R: 1\n" * 300_000]
)
def test_a_calibration_that_cannot_be_used(folder: Path, name: str, content: str | None) -> None:
    path = folder.parent / name
    if content is None:
        path.unlink()
    elif content.startswith("P_rect"):
        path = folder.parent / "calib_cam_to_cam.txt"
        lines = [line for line in path.read_text().splitlines(keepends=True) if not line.startswith("P_rect_02")]
        path.write_text("".join(lines) + content)
    else:
        path.write_bytes(content.encode("latin-1"))
    found = check(folder)
    assert len(found.must) == 1
    assert found.must[0].startswith("calibration of 2011_09_26 cannot be used: ")
    assert found.advice() == f"unzip -o 2011_09_26_calib.zip -d {folder.parent.parent}"


def test_names_that_would_be_taken_for_frames(folder: Path) -> None:
    image(folder, 3).rename(folder / "image_02/data/3.png")
    (folder / "image_02/data/._0000000003.png").write_bytes(b"of a file manager")
    assert check(folder).must == ["image_02: 3.png is not named as KITTI names frames (1 such): rename or remove it"]


def test_what_the_project_does_not_read_is_only_worth_knowing(folder: Path) -> None:
    kitti_drive.write_png(folder / "image_03/data/0000000000.png", np.zeros((4, 4, 3), np.uint8))
    for path in (folder / "velodyne_points/data").iterdir():
        empty(path)
    found = check(folder, lidar=False)
    assert found.must == []
    assert {note.partition(":")[0].partition(" ")[0] for note in found.notes} == {"image_03", "velodyne_points"}
    assert check(folder, cameras=(1,)).must[-1] == "has images of cameras [2, 3] alone, and ingest.cameras takes [1]"


def test_labels_alone(folder: Path, tmp_path: Path) -> None:
    bare = kitti_drive.write_drive(tmp_path / "bare", camera=None, lidar=False)
    found = check(bare)
    assert found.notes[-1] == "has neither images nor scans: labels alone can be made of it"


def test_runs() -> None:
    assert raw_check.runs([]) == []
    assert raw_check.runs([3]) == [[3, 3]]
    assert raw_check.runs([1, 2, 5, 7, 8, 9]) == [[1, 2], [5, 5], [7, 9]]
