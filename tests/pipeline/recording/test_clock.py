"""Which images have motion, and times of images from a file."""

from pathlib import Path

import numpy as np
import pytest

from pipeline.base.errors import InputError
from pipeline.camera.footage import open_footage
from pipeline.recording.clock import coverage, read_times, timed
from tests.footage import pictures
from tests.kitti_drive import write_png


def test_images_between_close_samples_are_usable() -> None:
    times = np.array([-1.0, -0.0005, 0, 0.1, 0.25, 0.7, 1.0, 1.1, 2.0])
    samples = np.array([0, 0.2, 0.4, 1.0, 1.1])
    usable, counts = coverage(samples, times, max_gap_s=0.5)
    assert usable.tolist() == [False, True, True, True, True, False, True, True, False]
    # 3 interpolated, including the one within a rounding error of the first sample
    left_out = {"before": 1, "after": 1, "in_gaps": 1}
    assert counts == {"interpolated": 3, "largest_gap_s": pytest.approx(0.2), "left_out": left_out}
    _, counts = coverage(samples, times, max_gap_s=0.61)
    assert counts == {"interpolated": 4, "largest_gap_s": pytest.approx(0.6), "left_out": left_out | {"in_gaps": 0}}
    usable, counts = coverage(np.array([0.0, 10]), np.array([4.0, 5.0]), max_gap_s=2)
    assert (usable.any(), counts["left_out"]["in_gaps"], counts["largest_gap_s"]) == (False, 2, 0)


@pytest.mark.parametrize(
    "text", ["", "1\n12:30\n", "inf\n", "1\n2\n2\n", "0\n1e12\n", "-62e9\n1\n", "1\n1.000000000001\n"]
)
def test_unusable_times(tmp_path: Path, text: str) -> None:
    path = tmp_path / "times.txt"
    path.write_text(text)
    with pytest.raises(InputError) as raised:
        read_times(path)
    assert raised.value.where == str(path)
    with pytest.raises(InputError, match="missing"):
        read_times(tmp_path / "nothing.txt")


def test_names_in_nanoseconds_are_times(tmp_path: Path) -> None:
    stamps = [1479424215880976321, 1479424215930976321, 1479424216040976321]
    for stamp, image in zip(stamps, pictures(3), strict=True):
        write_png(tmp_path / f"{stamp}.png", image)
    seconds = [time_s for time_s, _ in timed(open_footage(tmp_path), None)]
    assert seconds == pytest.approx([0, 0.05, 0.16], abs=1e-12)
    assert [time_s for time_s, _ in timed(open_footage(tmp_path, fps=4), None)] == [0, 0.25, 0.5]
