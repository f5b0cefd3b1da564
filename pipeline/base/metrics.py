"""Compute errors of predictions: squared, and relative to a prediction of zero.

True values have shape [N]. Predictions have shape [N], or [S,N] if they are those of S networks.
"""

import numpy as np


def mse(truth: np.ndarray, predicted: np.ndarray) -> float:
    """Return the mean squared error, in the square of the values' unit."""
    return float(np.mean((predicted - truth) ** 2))


def rmse(truth: np.ndarray, predicted: np.ndarray) -> float:
    """Return the root of the mean squared error, in the values' unit."""
    return float(np.sqrt(np.mean((predicted - truth) ** 2)))


def nmse(truth: np.ndarray, predicted: np.ndarray) -> float | None:
    """Return the mean squared error relative to that of always predicting zero.

    0 is perfect, and 1 is as good as predicting zero. None if there are no true values, or all are
    0.
    """
    if not len(truth):
        return None
    mse_of_zero = float(np.mean(truth**2))
    if not mse_of_zero > 0:
        return None
    return mse(truth, predicted) / mse_of_zero
