"""Metrics of your own, beside the nmse and the mean absolute error: see docs/models.md."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from pipeline.train.quantity import Quantity


class Metric(NamedTuple):
    """A metric of the quantities that have one of some units."""

    # Function of true values [N] and predictions [S,N] of S seeds, which has these values' quantity
    # and the number of their column in it, and returns None where the metric is not defined.
    compute: Callable[[np.ndarray, np.ndarray, Quantity, int], float | None]
    # Units of the values for which the metric is defined, for instance rad, the angle's, and 1/m,
    # the path's. Tables of quantities in other units do not have it.
    units: tuple[str, ...]


# Name → metric, which is a column of tables. To use your own metric, add an entry.
METRICS: dict[str, Metric] = {}
