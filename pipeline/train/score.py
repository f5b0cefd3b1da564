"""The validation score, which decides which epoch is kept. All other judging is in pipeline/report/judge."""

import math

import numpy as np


def mse(steering_rad: np.ndarray, predicted_rad: np.ndarray) -> float:
    """Return the mean squared error in rad² of predictions [N], or of S seeds' predictions [S,N] on average."""
    return float(np.mean((predicted_rad - steering_rad) ** 2))


def nmse(steering_rad: np.ndarray, predicted_rad: np.ndarray) -> float:
    """Return MSE / MSE of always predicting zero: 1 is useless, 0 perfect, NaN where every label is 0."""
    zero = mse(steering_rad, np.zeros_like(steering_rad))
    return mse(steering_rad, predicted_rad) / zero if zero > 0 else math.nan
