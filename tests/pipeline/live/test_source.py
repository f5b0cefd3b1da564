"""Sources: cropping, frame numbers and times."""

import os
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from pipeline.base.errors import InputError
from pipeline.labels.label import Car
from pipeline.live.source import Lens, Source, open_source
from tests import kitti_drive


def open_path(path: Path, lens: Lens = Lens(), aspect: tuple[int, int] = (48, 64), scans: bool = False) -> Source:
    return open_source(path, [2, 0], lens, aspect, scans, Car(2.7, 1.0))


@pytest.mark.parametrize(
    ("size", "axis", "expected"),
    [
        ((100, 160), (80.0, 30.0), (slice(10, 50), slice(0, 160))),  # too tall: the axis is centred
        ((100, 160), (80.0, 5.0), (slice(0, 40), slice(0, 160))),  # within the image
        ((20, 160), (100.0, 9.0), (slice(0, 20), slice(60, 140))),  # too wide
    ],
)
def test_images_are_cropped_around_the_optical_axis(
    tmp_path: Path, size: tuple[int, int], axis: tuple[float, float], expected: tuple[slice, slice]
) -> None:
    image = np.random.default_rng(0).integers(0, 255, (*size, 3), np.uint8)
    cv2.imwrite(str(tmp_path / "7.png"), image)
    source = open_path(tmp_path, Lens(K=f"90,90,{axis[0]},{axis[1]}"), (192, 768))
    (frame,) = source.frames
    rows, columns = expected
    np.testing.assert_array_equal(frame.image, image[rows, columns, ::-1])
    np.testing.assert_array_equal(frame.source_image, image[..., ::-1])
    assert source.camera.size == source.shown == size
    assert source.cropped.size == frame.image.shape[:2]
    np.testing.assert_allclose(source.cropped.K[:2, 2], [axis[0] - columns.start, axis[1] - rows.start])
    assert frame.driven_rad is None


def test_frames_of_a_drive_are_those_of_stage_ingest(tmp_path: Path) -> None:
    folder = kitti_drive.write_drive(tmp_path, frames=[0, 1, 3, 4])
    (folder / "oxts/data/0000000001.txt").unlink()
    source = open_path(folder, scans=True)
    frames = list(source.frames)
    assert [frame.number for frame in frames] == [0, 3, 4]
    assert [frame.time_s for frame in frames] == pytest.approx([0.0, 0.3, 0.4])
    assert source.name == kitti_drive.DRIVE
    assert source.has_scans
    assert all(frame.scan is not None and frame.scan.shape[1] == 4 for frame in frames)


@pytest.mark.parametrize("name", ["loop", "nothing", "pipe"])
def test_paths_that_are_no_source_are_refused(tmp_path: Path, name: str) -> None:
    (tmp_path / "loop").symlink_to("loop")
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(InputError, match=name):
        open_path(tmp_path / name, Lens(fov_deg=80.0))


def test_a_name_that_is_not_utf8_becomes_printable(tmp_path: Path) -> None:
    folder = tmp_path / os.fsdecode(b"street\xff")
    cv2.imwrite(str(tmp_path / "7.png"), np.zeros((48, 64, 3), np.uint8))
    folder.mkdir()
    (tmp_path / "7.png").rename(folder / "7.png")
    assert open_path(folder, Lens(fov_deg=80.0)).name == r"street\xff"


def test_without_oxts_truth_is_the_recorded_angle(tmp_path: Path) -> None:
    folder = kitti_drive.write_drive(tmp_path, frames=[0, 1, 2])
    kitti_drive.write(folder / "steering.csv", "frame,steering_rad\n1,0.1\n2,-0.2\n")
    source = open_path(folder)
    assert source.truth == "oxts"
    assert all(frame.driven_rad not in (0.1, -0.2) for frame in source.frames)
    shutil.move(folder / "oxts/timestamps.txt", folder / "image_02/timestamps.txt")
    shutil.rmtree(folder / "oxts")
    source = open_path(folder)
    assert source.truth == "steering.csv"
    assert [frame.driven_rad for frame in source.frames] == [None, 0.1, -0.2]
    kitti_drive.write(folder / "steering.csv", "frame,steering_rad\n1,15\n")
    source = open_path(folder)
    assert source.truth == ""
    assert "without the driven angle" in source.notes[0]


def test_a_damaged_packet_costs_only_the_driven_angle(tmp_path: Path) -> None:
    folder = kitti_drive.write_drive(tmp_path, frames=[0, 1, 2, 3])
    for number in (1, 2):
        (folder / f"oxts/data/{number:010d}.txt").write_text("nan")
    source = open_path(folder)
    assert [(frame.number, frame.driven_rad is None) for frame in source.frames] == [
        (0, False), (1, True), (2, True), (3, False)
    ]  # fmt: skip
    assert len(source.notes) == 1
    assert "0000000001.txt" in source.notes[0]
