import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.motion import step
from pipeline.motion.step import TYPICAL_MPS, filter_speed
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


COUNT = 900
TIME_S = np.arange(COUNT) / 10


def filtered(speed_mps: np.ndarray, road: bool, noise: float = 0.01) -> tuple[np.ndarray, np.ndarray]:
    rows = len(speed_mps)
    return filter_speed(TIME_S[:rows], speed_mps, np.full(rows, road), np.full(rows, noise))


def test_with_a_road_speed_is_that_of_the_images() -> None:
    """From 12 m/s to 1.5 m/s in 6 s, and back: as hard as a car brakes in traffic."""
    true_mps = 6.75 + 5.25 * np.cos(TIME_S * np.pi / 6)
    speed_mps, sigma = filtered(true_mps, road=True)
    assert np.abs(speed_mps - true_mps).max() < 0.1
    assert np.median(sigma) < 0.1


def test_without_a_road_the_scale_of_depth_is_not_believed() -> None:
    """Depth that makes bends slow, as measured with a lens of 17 degrees, must not make them sharp."""
    rng, error = np.random.default_rng(0), np.zeros(COUNT)
    for row in range(1, COUNT):
        error[row] = 0.96 * error[row - 1] + rng.normal(0, 0.6 * np.sqrt(1 - 0.96**2))
    speed_mps, sigma = filtered(14.0 * np.exp(error), road=False)
    assert np.log(speed_mps).std() < 0.2 < error.std()
    assert np.median(sigma) > 0.25  # it admits the uncertainty
    assert np.median(speed_mps) == pytest.approx(TYPICAL_MPS, rel=0.4)


def test_reversing_and_standing_keep_sign_and_zero() -> None:
    speed_mps, _ = filtered(np.array([-2.0] * 20 + [0.0] * 5), road=True, noise=0.02)
    assert speed_mps[10:20] == pytest.approx([-2.0] * 10, rel=0.05)
    assert (speed_mps[20:] == 0).all()


@given(st.lists(st.tuples(st.floats(0.1, 40), st.booleans()), min_size=2, max_size=20), st.integers(1, 19))
def test_it_is_causal(rows: list[tuple[float, bool]], known: int) -> None:
    speed, road = np.array([speed for speed, _ in rows]), np.array([road for _, road in rows])
    noise = np.full(len(rows), 0.01)
    complete = filter_speed(TIME_S[: len(rows)], speed, road, noise)
    start = filter_speed(TIME_S[: len(rows)][:known], speed[:known], road[:known], noise[:known])
    np.testing.assert_array_equal(np.stack(complete)[:, :known], np.stack(start))
