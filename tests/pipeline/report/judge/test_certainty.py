import numpy as np
import pytest

from pipeline.report.judge import certainty


def test_scores_of_normal_errors_with_known_sigma() -> None:
    rng = np.random.default_rng(0)
    sigma = rng.choice([0.01, 0.01, 0.04], size=(2, 50_000))
    steering = np.zeros(50_000)
    found = certainty.scores(steering, steering + sigma * rng.standard_normal(sigma.shape), sigma)
    assert found["coverage_68"] == pytest.approx(0.6827, abs=0.01)
    assert found["coverage_95"] == pytest.approx(0.95, abs=0.01)
    entropy = np.log(2 * np.pi * np.e) / 2
    assert found["nll"] == pytest.approx(np.mean(np.log([0.01, 0.01, 0.04])) + entropy, abs=0.01)
    assert found["nll_constant"] == pytest.approx(
        np.log(np.sqrt(np.mean([0.01**2, 0.01**2, 0.04**2]))) + entropy, abs=0.01
    )
    assert found["mae_deg_certain"] == pytest.approx(np.sqrt(2 / np.pi) * np.rad2deg(0.01), rel=0.02)


def test_too_small_a_sigma_covers_less() -> None:
    error = np.array([[0.5, 1.5, 2.5]])
    found = certainty.scores(np.zeros(3), error, np.ones((1, 3)))
    assert (found["coverage_68"], found["coverage_95"]) == (pytest.approx(1 / 3), pytest.approx(2 / 3))
