"""Which images have motion: those between samples that are close enough; and when images were taken."""

from pathlib import Path

import numpy as np
import pytest

from pipeline.base.errors import InputError
from pipeline.camera.footage import open_footage
from pipeline.recording.clock import check_overlap, coverage, read_times, timed
from pipeline.recording.track import Rates
from tests.footage import pictures, write_folder, write_video


def sampled(*time_s: float) -> Rates:
    return Rates(np.array(time_s, float), np.zeros(len(time_s)), np.zeros(len(time_s)))


def test_images_are_between_samples_or_left_out() -> None:
    times = np.array([-1.0, -0.0005, 0, 0.1, 0.25, 0.7, 1.0, 1.1, 2.0])
    covered = coverage(sampled(0, 0.2, 0.4, 1.0, 1.1), times, max_gap_s=0.5)
    assert covered.kept.tolist() == [False, True, True, True, True, False, True, True, False]
    assert (covered.before, covered.after, covered.in_gaps) == (1, 1, 1)
    assert covered.interpolated == 3  # the one within a rounding of the first sample, too
    assert covered.largest_gap_s == pytest.approx(0.2)
    wider = coverage(sampled(0, 0.2, 0.4, 1.0, 1.1), times, max_gap_s=0.61)
    assert (wider.in_gaps, wider.interpolated, wider.largest_gap_s) == (0, 4, pytest.approx(0.6))


def test_no_image_has_motion() -> None:
    covered = coverage(sampled(0, 10), np.array([4.0, 5.0]), max_gap_s=2)
    assert (covered.kept.any(), covered.in_gaps, covered.interpolated, covered.largest_gap_s) == (False, 2, 0, 0)


def test_times_that_do_not_meet() -> None:
    check_overlap(sampled(5, 9), 0, 5)
    check_overlap(sampled(5, 9), 9, float("inf"))
    with pytest.raises(InputError, match=r"0.000 to 4.900 s, and the motion's, 5.000 to 9.000 s.*\(-5.000 more makes"):
        check_overlap(sampled(5, 9), 0, 4.9)
    with pytest.raises(InputError, match="do not overlap"):
        check_overlap(sampled(5, 9), 9.1, 12)


def test_times_of_a_file(tmp_path: Path) -> None:
    path = tmp_path / "times.txt"
    path.write_text("1774951200.125\n1774951200.250 \n1774951200.5\n\n")
    np.testing.assert_array_equal(read_times(path) - 1774951200, [0.125, 0.25, 0.5])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1\n\n2\n", "line 2: nothing is not a number of seconds"),
        ("1\n12:30\n", "line 2: 12:30 is not a number"),
        ("inf\n", "line 1: inf is not a number"),
        ("1\n2\n2\n", "time goes from 2 to 2 at line 3, it must increase"),
    ],
)
def test_what_is_wrong_with_times(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "times.txt").write_text(text)
    with pytest.raises(InputError, match=message):
        read_times(tmp_path / "times.txt")
    with pytest.raises(InputError, match="is missing: --times wants"):
        read_times(tmp_path / "nothing.txt")


def test_images_at_the_times_of_a_file_or_their_own(tmp_path: Path) -> None:
    video = open_footage(write_video(tmp_path / "a.mp4", pictures(3), fps=8))
    assert [time_s for time_s, _ in timed(video, None)] == pytest.approx([0, 0.125, 0.25])
    told = [(time_s, image.number) for time_s, image in timed(video, np.array([7.0, 7.1, 7.3]))]
    assert told == [(7.0, 0), (7.1, 1), (7.3, 2)]


@pytest.mark.parametrize("times", [2, 4])
def test_there_is_one_time_for_each_image(tmp_path: Path, times: int) -> None:
    for footage in (
        open_footage(write_folder(tmp_path / "a", pictures(3))),
        open_footage(write_video(tmp_path / "a.mp4", pictures(3))),
    ):
        with pytest.raises(InputError, match=rf"has 3 images, and --times has {times} times"):
            list(timed(footage, np.arange(float(times))))


def test_images_without_any_time(tmp_path: Path) -> None:
    footage = open_footage(write_folder(tmp_path, pictures(3)))
    with pytest.raises(InputError, match="does not say when its images were taken: say --fps N, or --times FILE"):
        list(timed(footage, None))
