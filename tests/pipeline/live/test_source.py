"""Sources: what is cut off an image moves the optical axis, a KITTI drive is keyed on numbers and times of its own."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from pipeline.base.errors import InputError
from pipeline.live.source import Lens, open_source
from pipeline.train.windows import Car
from tests import kitti_drive

CAR = Car(2.7, 1.0)


@pytest.mark.parametrize(
    ("size", "axis", "expected"),
    [
        ((100, 160), (80.0, 30.0), (slice(10, 50), slice(0, 160))),  # too tall: rows go, the axis stays in the middle
        ((100, 160), (80.0, 5.0), (slice(0, 40), slice(0, 160))),  # but no row is invented
        ((20, 160), (100.0, 9.0), (slice(0, 20), slice(60, 140))),  # too wide
    ],
)
def test_an_image_is_cut_to_a_shape_around_the_optical_axis(
    tmp_path: Path, size: tuple[int, int], axis: tuple[float, float], expected: tuple[slice, slice]
) -> None:
    image = np.random.default_rng(0).integers(0, 255, (*size, 3), np.uint8)
    cv2.imwrite(str(tmp_path / "7.png"), image)
    lens = Lens(K=f"90,90,{axis[0]},{axis[1]}")
    source = open_source(tmp_path, [2, 0], lens, (192, 768), scans=False, car=CAR)
    (moment,) = source.moments
    rows, columns = expected
    np.testing.assert_array_equal(moment.image, image[rows, columns, ::-1])
    assert source.view.size == moment.image.shape[:2]
    # A point of the street falls on the same pixel of the street.
    np.testing.assert_allclose(source.view.K[:2, 2], [axis[0] - columns.start, axis[1] - rows.start])
    assert moment.driven_rad is None


def test_frames_of_a_drive_have_numbers_times_scans_and_the_driven_angle(tmp_path: Path) -> None:
    folder = kitti_drive.write_drive(tmp_path, frames=[0, 1, 3, 4])
    (folder / "oxts/data/0000000001.txt").unlink()
    source = open_source(folder, [2, 0], Lens(), (48, 64), scans=True, car=CAR)
    moments = list(source.moments)
    assert [moment.number for moment in moments] == [0, 3, 4]  # as stage ingest takes them
    assert [moment.time_s for moment in moments] == pytest.approx([0.0, 0.3, 0.4])
    assert source.view.name == kitti_drive.DRIVE
    assert source.view.scans
    assert all(moment.scan is not None and moment.scan.shape[1] == 4 for moment in moments)


def test_a_drive_of_images_alone_has_the_cameras_times_or_nominal_ones(tmp_path: Path) -> None:
    folder = kitti_drive.write_drive(tmp_path, frames=[0, 1, 2], lidar=False)
    for path in sorted((folder / "oxts").rglob("*"), reverse=True):
        path.unlink() if path.is_file() else path.rmdir()
    source = open_source(folder, [2, 0], Lens(), (48, 64), scans=False, car=CAR)
    assert [moment.time_s for moment in source.moments] == pytest.approx([0.0, 0.1, 0.2])
    assert "timestamps.txt is missing: frames are taken to come 10 times a second" in source.notes[0]
    stamps = "".join(f"2011-09-26 13:02:{25 + number / 5:012.9f}\n" for number in range(3))
    (folder / "image_02/timestamps.txt").write_text(stamps)
    source = open_source(folder, [2, 0], Lens(), (48, 64), scans=False, car=CAR)
    assert [moment.time_s for moment in source.moments] == pytest.approx([0.0, 0.2, 0.4])
    assert source.fps == pytest.approx(5.0)
    assert not source.notes


def test_what_a_drive_lacks_is_said(tmp_path: Path) -> None:
    folder = kitti_drive.write_drive(tmp_path, camera=None)
    with pytest.raises(InputError, match="has no images of camera 2 or 0: extract image_02 as well"):
        open_source(folder, [2, 0], Lens(), (48, 64), scans=False, car=CAR)
    folder = kitti_drive.write_drive(tmp_path / "other")
    with pytest.raises(InputError, match="a calibration of its own"):
        open_source(folder, [2, 0], Lens(fov_deg=80), (48, 64), scans=False, car=CAR)
