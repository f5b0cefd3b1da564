"""Motion of a stream is that of stage motion, frame by frame; the angle is held where nothing is measured."""

import numpy as np
import pytest

from pipeline import label
from pipeline.live.moment import Moment, Motion
from pipeline.live.odometry import MeasuredAngle, Odometry
from pipeline.motion.step import durations


def test_the_angle_of_a_stream_is_that_of_the_whole_drive() -> None:
    rng = np.random.default_rng(0)
    yaw_rate_radps, speed_mps = rng.normal(0, 0.3, 40), rng.uniform(-2, 6, 40)
    valid = rng.random(40) < 0.6
    angle = MeasuredAngle(2.7, 1.0)
    stream = [angle.of(Motion(*row)) for row in zip(yaw_rate_radps.tolist(), speed_mps.tolist(), valid, strict=True)]
    np.testing.assert_array_equal(stream, label.measured_angle(yaw_rate_radps, speed_mps, valid, 2.7, 1.0))
    assert stream[0] == 0.0 or valid[0]


def moment(number: int, scan: np.ndarray | None, time_s: float) -> Moment:
    return Moment(number, time_s, np.zeros((4, 4, 3), np.uint8), 0.0, scan)


def test_a_frame_without_a_scan_is_not_one_that_steps_are_timed_by(monkeypatch: pytest.MonkeyPatch) -> None:
    from pipeline.motion import lidar, step

    ahead = np.eye(4)
    ahead[2, 3] = 1.0  # a metre
    monkeypatch.setattr(lidar.Odometry, "step", lambda *_: step.Step(ahead, 500, 0.01))
    odometry = Odometry("lidar", np.eye(3), (4, 4), None, np.eye(4))
    times = [0.0, 0.1, 0.2, 0.29, 0.41, 0.5]
    with_scan = [0, 1, 4, 5]
    scan = np.zeros((1, 4), np.float32)
    speeds = []
    for number, time_s in enumerate(times):
        seen, motion = odometry.measure(moment(number, scan if number in with_scan else None, time_s))
        assert (seen is None) == (number not in with_scan) == (not motion.valid)
        speeds += [motion.speed_mps] if motion.valid else []
    known = durations(np.array(with_scan), np.array(times)[with_scan])
    # Its own first frame apart, whose time the stream cannot know yet.
    np.testing.assert_allclose(speeds[1:], 1 / known[1:], rtol=1e-6)
