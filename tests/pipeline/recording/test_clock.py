"""Which images have motion, and when images were taken."""

from pathlib import Path

import numpy as np
import pytest

from pipeline.base.errors import InputError
from pipeline.camera.footage import open_footage
from pipeline.recording.clock import check_overlap, coverage, read_times, timed
from tests.footage import pictures, write_folder, write_video
from tests.kitti_drive import write_png


def sampled(*time_s: float) -> np.ndarray:
    return np.array(time_s, float)


def test_images_between_close_samples_are_usable() -> None:
    times = np.array([-1.0, -0.0005, 0, 0.1, 0.25, 0.7, 1.0, 1.1, 2.0])
    covered = coverage(sampled(0, 0.2, 0.4, 1.0, 1.1), times, max_gap_s=0.5)
    assert covered.usable.tolist() == [False, True, True, True, True, False, True, True, False]
    assert (covered.before, covered.after, covered.in_gaps) == (1, 1, 1)
    assert covered.interpolated == 3  # including the one within a rounding error of the first sample
    assert covered.largest_gap_s == pytest.approx(0.2)
    wider = coverage(sampled(0, 0.2, 0.4, 1.0, 1.1), times, max_gap_s=0.61)
    assert (wider.in_gaps, wider.interpolated, wider.largest_gap_s) == (0, 4, pytest.approx(0.6))
    none = coverage(sampled(0, 10), np.array([4.0, 5.0]), max_gap_s=2)
    assert (none.usable.any(), none.in_gaps, none.interpolated, none.largest_gap_s) == (False, 2, 0, 0)


def test_overlap() -> None:
    check_overlap("motion", sampled(5, 9), 0, 5)
    check_overlap("motion", sampled(5, 9), 9, float("inf"))
    for span, offset in (((0, 4.9), "-5.000"), ((9.1, 12), "+4.100")):
        with pytest.raises(InputError) as raised:
            check_overlap("motion", sampled(5, 9), *span)
        assert f"--offset by {offset}" in raised.value.fix


def test_times_from_a_file(tmp_path: Path) -> None:
    path = tmp_path / "times.txt"
    path.write_text("1774951200.125\n1774951200.250 \n1774951200.5\n\n")
    np.testing.assert_array_equal(read_times(path) - 1774951200, [0.125, 0.25, 0.5])


@pytest.mark.parametrize("text", ["", "1\n12:30\n", "inf\n", "1\n2\n2\n", "0\n1e12\n", "-62e9\n1\n"])
def test_unusable_times(tmp_path: Path, text: str) -> None:
    path = tmp_path / "times.txt"
    path.write_text(text)
    with pytest.raises(InputError) as raised:
        read_times(path)
    assert raised.value.where == str(path)
    with pytest.raises(InputError, match="missing"):
        read_times(tmp_path / "nothing.txt")


def test_times_of_images(tmp_path: Path) -> None:
    video = open_footage(write_video(tmp_path / "a.mp4", pictures(3), fps=8))
    folder = open_footage(write_folder(tmp_path / "a", pictures(3)))
    assert [time_s for time_s, _ in timed(video, None)] == pytest.approx([0, 0.125, 0.25])
    given = [(time_s, image.number) for time_s, image in timed(video, np.array([7.0, 7.1, 7.3]))]
    assert given == [(7.0, 0), (7.1, 1), (7.3, 2)]
    for footage in (folder, video):
        for count in (2, 4):
            with pytest.raises(InputError, match=rf"3 images, .* {count} lines"):
                list(timed(footage, np.arange(float(count))))
    with pytest.raises(InputError) as raised:
        list(timed(folder, None))
    assert "--fps" in raised.value.fix


def test_names_in_nanoseconds_are_times(tmp_path: Path) -> None:
    stamps = [1479424215880976321, 1479424215930976321, 1479424216040976321]
    for stamp, image in zip(stamps, pictures(3), strict=True):
        write_png(tmp_path / f"{stamp}.png", image)
    seconds = [time_s for time_s, _ in timed(open_footage(tmp_path), None)]
    assert seconds == pytest.approx([0, 0.05, 0.16], abs=1e-12)
    assert [time_s for time_s, _ in timed(open_footage(tmp_path, fps=4), None)] == [0, 0.25, 0.5]
