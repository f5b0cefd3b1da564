import numpy as np
import pytest

from pipeline.train import score


def test_scores_by_hand() -> None:
    steering, predicted = np.array([0.1, -0.1, 0.2]), np.array([0.1, 0.1, 0.1])
    assert score.mse(steering, predicted) == pytest.approx((0 + 0.04 + 0.01) / 3)
    assert score.nmse(steering, predicted) == pytest.approx(0.05 / 0.06)
    assert score.nmse(steering, np.zeros(3)) == 1


def test_labels_that_are_all_zero_have_no_nmse() -> None:
    assert np.isnan(score.nmse(np.zeros(3), np.ones(3)))
