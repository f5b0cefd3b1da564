"""Poses of a track, by the definitions of KITTI's and TUM's formats."""

import io
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from pipeline.live.chain import Course, Estimate, FrameState
from pipeline.live.results import COLUMNS, MOTION, Results
from pipeline.live.track import draw_track, pose_lines
from pipeline.motion.step import Step

RADIUS_M, TURN_RAD = 10.0, np.pi / 2


def left_turn() -> Results:
    """A quarter of a circle in 11 frames; the first and the sixth are not measured."""
    results = Results(io.StringIO(), "drive", 1, COLUMNS[MOTION])
    for number in range(11):
        frame = FrameState(number, number / 10, driven_rad=0.1)
        if number not in (0, 5):
            heading = TURN_RAD * number / 10
            place = RADIUS_M * np.sin(heading), RADIUS_M * (1 - np.cos(heading)), heading
            frame.course = Course(5.0, 0.5, 0.1, 0.2, *place)
            frame.estimates["visual"] = Estimate(Step(np.eye(4), 10, 0.5), 0.5, 5.0)
        results.add(frame)
    return results


def test_kitti_has_a_matrix_for_each_frame() -> None:
    T = np.array([line.split() for line in pose_lines(left_turn(), "kitti")], float).reshape(-1, 3, 4)
    assert len(T) == 11
    np.testing.assert_array_equal(T[0], np.eye(4)[:3])
    np.testing.assert_array_equal(T[5], T[4])  # not measured
    np.testing.assert_allclose(T[10, :, 3], [-RADIUS_M, 0, RADIUS_M], atol=1e-6)  # to the left, and ahead
    np.testing.assert_allclose(T[10, :, :3] @ [0, 0, 1], [-1, 0, 0], atol=1e-6)  # now looks to the left
    np.testing.assert_allclose(T[10, :, :3] @ [0, 1, 0], [0, 1, 0], atol=1e-6)


def test_tum_has_the_same_poses_of_measured_frames() -> None:
    kitti = np.array([line.split() for line in pose_lines(left_turn(), "kitti")], float).reshape(-1, 3, 4)
    tum = np.array([line.split() for line in pose_lines(left_turn(), "tum")], float)
    measured = [1, 2, 3, 4, 6, 7, 8, 9, 10]
    np.testing.assert_allclose(tum[:, 0], np.array(measured) / 10)
    np.testing.assert_allclose(tum[:, 1:4], kitti[measured, :, 3], atol=1e-6)
    np.testing.assert_allclose(Rotation.from_quat(tum[:, 4:]).as_matrix(), kitti[measured, :, :3], atol=1e-6)


def test_the_picture_is_drawn_without_any_measured_frame(tmp_path: Path) -> None:
    results = Results(io.StringIO(), "drive", 1, COLUMNS[MOTION])
    results.add(FrameState(0, 0.0))
    draw_track(tmp_path / "empty.png", "drive", results)
    draw_track(tmp_path / "turn.png", "drive", left_turn())
    assert all(path.read_bytes().startswith(b"\x89PNG") for path in tmp_path.iterdir())
