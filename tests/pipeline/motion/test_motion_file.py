"""Test the reader of the measured motion that models get."""

import numpy as np
import pytest

from pipeline.base.errors import InputError
from pipeline.motion.motion_file import open_motion, read_causal
from tests.artefacts import write_motion


def test_causal_motion_is_matched_by_frame_number(tmp_path):
    """A frame without motion, or that the file lacks, is 0 and not valid."""
    write_motion(tmp_path, "drive", {3: (3, 0.3), 5: (5, 0.5), 9: (0, 0), 11: (11, 1.1)})
    with open_motion(tmp_path / "drive.h5") as motion:
        yaw_rate, speed, valid = read_causal(motion, "drive", np.array([4, 5, 9]))
    assert speed.tolist() == [0, 5, 0]
    assert valid.tolist() == [0, 1, 0]
    assert valid.dtype == np.uint8
    assert yaw_rate == pytest.approx([0, 0.5, 0])


def test_motion_of_another_drive_is_refused(tmp_path):
    write_motion(tmp_path, "drive", {3: (3, 0.3)})
    problem = r"drive\.h5: expected the motion of drive other, got drive drive"
    with open_motion(tmp_path / "drive.h5") as motion, pytest.raises(InputError, match=problem):
        read_causal(motion, "other", np.array([3]))
