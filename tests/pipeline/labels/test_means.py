"""Means of rates over neighbouring frames."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from pipeline.labels.label import steering_angle
from pipeline.labels.means import REACH, YAW_SIGMA_S, means

COUNT = 300


@given(st.lists(st.floats(0.05, 3.0), min_size=1, max_size=30), st.integers(0, 2**32 - 1))
def test_yaw_rates_are_gaussian_means(steps_s: list[float], seed: int) -> None:
    time_s = np.cumsum(steps_s)
    yaw_rate = np.random.default_rng(seed).normal(0, 0.3, len(time_s))
    rates = means(time_s, yaw_rate, np.full(len(time_s), 8.0), np.ones(len(time_s), bool))
    for row, at_s in enumerate(time_s):
        near = np.abs(time_s - at_s) <= REACH * YAW_SIGMA_S
        weights = np.exp(-(((time_s - at_s)[near] / YAW_SIGMA_S) ** 2) / 2)
        np.testing.assert_allclose(rates.yaw_rate_radps[row], np.average(yaw_rate[near], weights=weights), atol=1e-12)


def test_the_angles_sigma_covers_its_error() -> None:
    yaw_rate = 0.2 + np.random.default_rng(0).normal(0, 0.05, COUNT)
    rates = means(np.arange(COUNT) / 10, yaw_rate, np.full(COUNT, 8.0), np.ones(COUNT, bool))
    angle = steering_angle(rates.yaw_rate_radps, rates.speed_mps, 2.7)
    sigma = 2.7 * np.hypot(rates.yaw_sigma_radps / 8.0, 0.025 * rates.speed_sigma)
    error = angle - np.arctan(2.7 * 0.2 / 8.0)
    assert (np.abs(error) < 2 * sigma).mean() > 0.9
    assert sigma.mean() < 4 * error.std()
