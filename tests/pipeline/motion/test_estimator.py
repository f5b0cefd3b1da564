import numpy as np
import pytest

from pipeline.camera.frame import Camera, Frame
from pipeline.motion import lidar, step
from pipeline.motion.estimator import MotionEstimator

SCAN = np.zeros((1, 4), np.float32)


def test_frames_without_a_scan_do_not_count_for_the_duration_of_lidar_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    one_metre = np.eye(4)
    one_metre[2, 3] = 1.0
    monkeypatch.setattr(lidar.Odometry, "step", lambda *_: step.Step(one_metre, 500, 0.01))
    estimator = MotionEstimator("lidar", Camera((4, 4), np.eye(3), None, 1.65), road_scale=True)
    times, with_scan = [0.0, 0.1, 0.2, 0.29, 0.41, 0.5], [0, 1, 4, 5]
    estimates = [
        estimator.estimate(Frame(number, time_s, scan=SCAN if number in with_scan else None))
        for number, time_s in enumerate(times)
    ]
    assert [estimate is not None for estimate in estimates] == [number in with_scan for number in range(6)]
    clock = step.StepClock()
    expected = [1 / clock.duration(number, times[number]) for number in with_scan]
    speeds = [estimate.speed_mps for estimate in estimates if estimate]
    assert speeds[1:] == pytest.approx(expected[1:])
