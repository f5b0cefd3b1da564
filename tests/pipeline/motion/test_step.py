import numpy as np
import pytest

from pipeline.motion import step
from tests import street


@pytest.mark.parametrize("ahead_m", [0.0, 1.5])
@pytest.mark.parametrize("yaw_rate", [0.5, -0.5, 0.0])
def test_rates_are_those_of_the_axle_wherever_the_camera_is(yaw_rate: float, ahead_m: float) -> None:
    mount = np.eye(4)
    mount[2, 3] = ahead_m
    first, second = (pose @ mount for pose in street.arc(2, yaw_rate, 6.0))
    measured, speed = step.rates(np.linalg.inv(first) @ second, 0.1)
    assert measured == pytest.approx(yaw_rate)
    assert speed == pytest.approx(6.0, rel=1e-3)  # the chord of the arc


@pytest.mark.parametrize(
    ("translation", "expected"),
    [((0, 0, 0), True), ((0.3, 0, 1.5), True), ((0.9, 0, 0.2), False), ((0, 2.0, 1), False), ((0, 0, 30), False)],
)
def test_sideways_steps_and_jumps_are_not_plausible(translation: tuple[float, float, float], expected: bool) -> None:
    T = np.eye(4)
    T[:3, 3] = translation
    assert step.plausible(T) == expected


def test_durations_average_jitter_of_the_past_and_follow_another_rate() -> None:
    """As KITTI's times, on a grid of 10 ms; then every fourth frame is missing, then the rate is halved."""
    frame = np.concatenate([np.arange(60), 60 + 4 * np.arange(20), 140 + np.arange(20)])
    exact_s = np.interp(frame, [0, 140, 160], [0, 140 * 0.1037, 140 * 0.1037 + 20 * 0.2074])
    time_s = np.round(exact_s, 2)
    found = step.durations(frame, time_s)
    assert np.isnan(found[0])
    assert found[20:80] == pytest.approx(0.1037, rel=0.01)
    assert found[82:] == pytest.approx(0.2074, rel=0.02)
    assert np.abs(np.diff(time_s)[20:59] / 0.1037 - 1).max() > 0.03  # single differences are worse
    np.testing.assert_array_equal(step.durations(frame[:50], time_s[:50])[1:], found[1:50])
