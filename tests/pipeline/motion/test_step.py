import numpy as np
import pytest

from pipeline.motion import step
from tests import rendered_street as street


@pytest.mark.parametrize("ahead_m", [0.0, 1.5])
@pytest.mark.parametrize("yaw_rate", [0.5, -0.5, 0.0])
def test_rates_are_those_of_the_axle_wherever_the_camera_is_ahead_of_it(yaw_rate: float, ahead_m: float) -> None:
    mount = np.eye(4)
    mount[2, 3] = ahead_m
    first, second = (pose @ mount for pose in street.arc(2, yaw_rate, 6.0))
    turned, speed = step.rates(np.linalg.inv(first) @ second, 0.1)
    assert turned == pytest.approx(yaw_rate)
    assert speed == pytest.approx(6.0, rel=1e-3)  # the chord of the arc


def test_a_cars_step_is_plausible_and_a_sideways_one_or_a_jump_is_not() -> None:
    T = np.eye(4)
    assert step.plausible(T)
    for translation, allowed in (
        ((0.3, 0, 1.5), True),
        ((0.9, 0, 0.2), False),
        ((0, 2.0, 1), False),
        ((0, 0, 30), False),
    ):
        T[:3, 3] = translation
        assert step.plausible(T) == allowed


def test_durations_are_those_of_a_camera_that_keeps_time() -> None:
    """Times on a grid of 10 ms, as KITTI's packets have, of a camera with a period of 103.7 ms."""
    frame = np.delete(np.arange(60), [20, 21])
    time_s = np.round(frame * 0.1037, 2)
    assert np.abs(np.diff(time_s)[:10] / 0.1037 - 1).max() > 0.03
    found = step.durations(frame, time_s)
    assert np.abs(found / 0.1037 - 1).max() < 0.04  # the first step has but its own two times
    assert found[10:] == pytest.approx(0.1037, rel=0.011)


def test_no_later_time_is_known_to_a_step() -> None:
    time_s = np.round(np.arange(40) * 0.1037 + np.random.default_rng(0).normal(0, 0.01, 40), 2)
    whole = step.durations(np.arange(40), time_s)
    for known in range(2, 40):
        assert (step.durations(np.arange(known), time_s[:known]) == whole[:known]).all()


def test_a_pause_is_a_duration_of_its_own() -> None:
    time_s = np.array([0, 0.1, 0.2, 5.2, 5.3])
    assert step.durations(np.arange(5), time_s) == pytest.approx([0.1, 0.1, 0.1, 5.0, 0.1])
    assert np.isnan(step.durations(np.arange(1), time_s[:1])).all()
    assert step.durations(np.arange(0), time_s[:0]).shape == (0,)
