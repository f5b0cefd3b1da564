"""Metrics of your own, beside the nmse and the mean absolute error: see docs/models.md."""

from collections.abc import Callable

import numpy as np

from pipeline.train.quantity import Quantity

# A function of true values [N] and predictions [S,N] of S seeds, which has these values' quantity
# and the number of their column in it, and returns None where the metric is not defined.
Metric = Callable[[np.ndarray, np.ndarray, Quantity, int], float | None]

# Name → metric, which is a column of all tables. To use your own metric, add an entry.
METRICS: dict[str, Metric] = {}
