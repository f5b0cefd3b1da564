"""Errors relative to a prediction of zero."""

import numpy as np
import pytest

from pipeline.base.metrics import mse, nmse, rmse

TRUTH = np.array([1.0, -2.0, 0.0])


@pytest.mark.parametrize(
    ("predicted", "expected"),
    [(TRUTH, 0), (0 * TRUTH, 1), (-TRUTH, 4), (np.stack([TRUTH, 0 * TRUTH]), 0.5)],
)
def test_the_error_of_zero_is_1_and_networks_are_averaged(predicted, expected):
    assert nmse(TRUTH, predicted) == pytest.approx(expected)
    assert mse(TRUTH, predicted) == pytest.approx(expected * 5 / 3)
    assert rmse(TRUTH, predicted) == pytest.approx((expected * 5 / 3) ** 0.5)


@pytest.mark.parametrize("truth", [np.zeros(3), np.zeros(0)])
def test_without_truth_there_is_no_relative_error(truth):
    assert nmse(truth, truth + 1) is None
