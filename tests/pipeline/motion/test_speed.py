"""The filter of speeds: with a road it follows the images, without one it does not believe the scale of depth."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.motion.speed import TYPICAL_MPS, filter_speed

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
