"""Errors of predictions. Training selects epochs by them; pipeline/report/judge computes all other figures."""

import math

import numpy as np


def mse(steering_rad: np.ndarray, predicted_rad: np.ndarray) -> float:
    """Return the mean squared error in rad² of predictions [N], or its mean over S seeds' predictions [S,N]."""
    return float(np.mean((predicted_rad - steering_rad) ** 2))


def nmse(steering_rad: np.ndarray, predicted_rad: np.ndarray) -> float:
    """Return MSE / MSE of always predicting zero: 0 is perfect, 1 useless; NaN where each label is 0."""
    zero = mse(steering_rad, np.zeros_like(steering_rad))
    return mse(steering_rad, predicted_rad) / zero if zero > 0 else math.nan
