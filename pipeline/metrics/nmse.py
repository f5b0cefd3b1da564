"""MSE / MSE of always predicting zero: 0 is perfect, 1 is useless."""

import numpy as np


def score(truth: np.ndarray, predicted: np.ndarray) -> float | None:
    """Return the error of predictions [N] or [S,N] for true values [N]; None if all of these are 0."""
    zero = float(np.mean(truth**2)) if len(truth) else 0.0
    return float(np.mean((predicted - truth) ** 2)) / zero if zero > 0 else None
