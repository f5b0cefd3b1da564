"""Errors of predictions for true values: squared, absolute, and relative to a prediction of
zero.
"""

import numpy as np


def mse(truth: np.ndarray, predicted: np.ndarray) -> float:
    """Return the mean squared error of predictions [N] or [S,N] for true values [N], in the square
    of their unit.
    """
    return float(np.mean((predicted - truth) ** 2))


def rmse(truth: np.ndarray, predicted: np.ndarray) -> float:
    """Return the root of the mean squared error of predictions [N] or [S,N] for true values [N], in
    their unit.
    """
    return float(np.sqrt(np.mean((predicted - truth) ** 2)))


def mae(truth: np.ndarray, predicted: np.ndarray) -> float:
    """Return the mean absolute error of predictions [N] or [S,N] for true values [N], in their
    unit.
    """
    return float(np.mean(np.abs(predicted - truth)))


def nmse(truth: np.ndarray, predicted: np.ndarray) -> float | None:
    """Return the mean squared error relative to that of always predicting zero: 0 is perfect, 1 is
    useless.

    Of predictions [N] or [S,N] for true values [N]; None if all of these are 0.
    """
    zero = float(np.mean(truth**2)) if len(truth) else 0.0
    return float(np.mean((predicted - truth) ** 2)) / zero if zero > 0 else None
