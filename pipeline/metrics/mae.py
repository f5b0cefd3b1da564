"""Mean absolute error."""

import numpy as np


def score(truth: np.ndarray, predicted: np.ndarray) -> float | None:
    """Return the error of predictions [N] or [S,N] for true values [N], in their unit."""
    return float(np.mean(np.abs(predicted - truth)))
