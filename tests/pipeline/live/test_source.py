"""Sources: cropping, frame numbers and times."""

import os
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from pipeline.base.errors import InputError
from pipeline.labels.label import Car
from pipeline.live.source import Clock, Lens, Source, open_source
from pipeline.live.truth import of_logs
from tests import kitti_drive
from tests.footage import write_folder


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


def test_logs_are_the_truth_of_images(tmp_path: Path) -> None:
    images = write_folder(tmp_path / "images", [np.zeros((48, 64, 3), np.uint8)] * 4)
    wheel, motion = tmp_path / "wheel.csv", tmp_path / "can.csv"
    motion.write_text("time_s,speed_mps,yaw_rate_radps\n0.05,10,0.5\n0.25,20,0.5\n")

    def driven(*logs: Path | float | None) -> list[tuple[float | None, float | None]]:
        truth = of_logs(*logs, Car(2.7, 1.0))  # type: ignore[arg-type]
        source = open_source(images, [2], Lens(fov_deg=80.0), (48, 64), False, Car(2.7, 1.0), Clock(10), truth=truth)
        assert source.truth == (truth.name if truth else "")
        return [(frame.driven_rad, frame.driven_mps) for frame in source.frames]

    by_motion = driven(None, None, motion)
    assert [mps for _, mps in by_motion] == [None, pytest.approx(12.5), pytest.approx(17.5), None]
    assert [rad for rad, _ in by_motion] == [
        None, pytest.approx(np.arctan(2.7 * 0.5 / 12.5)), pytest.approx(np.arctan(2.7 * 0.5 / 17.5)), None
    ]  # fmt: skip
    wheel.write_text("frame,wheel_rad\n1,1.4\n3,-0.7\n")
    assert [rad for rad, _ in driven(wheel, 14.0, None)] == [None, pytest.approx(0.1), None, pytest.approx(-0.05)]
    wheel.write_text("time_s,wheel_rad\n0,1.4\n0.2,2.8\n")
    both = [pytest.approx(0.1), pytest.approx(0.15), pytest.approx(0.2), None]
    assert [rad for rad, _ in driven(wheel, 14.0, motion)] == both
    assert driven(None, None, None) == [(None, None)] * 4
    with pytest.raises(InputError, match="--steering-ratio"):
        driven(wheel, None, None)


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
