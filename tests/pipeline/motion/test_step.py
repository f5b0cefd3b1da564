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


def durations(frame: np.ndarray, time_s: np.ndarray) -> np.ndarray:
    clock = step.StepClock()
    return np.array([clock.duration(*pair) for pair in zip(frame.tolist(), time_s.tolist(), strict=True)])


def test_durations_equal_the_mean_of_recent_similar_steps() -> None:
    time_s = np.cumsum(np.random.default_rng(0).uniform(0.05, 0.2, 60))
    steps = np.diff(time_s)
    expected = []
    for row, own in enumerate(steps):
        recent = steps[max(0, row + 1 - step.RECENT) : row + 1]
        expected.append(recent[(recent < own * step.SIMILAR) & (recent > own / step.SIMILAR)].mean())
    np.testing.assert_allclose(durations(np.arange(60), time_s)[1:], expected, rtol=1e-12)
