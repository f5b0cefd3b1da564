"""The trivial predictors that every model stands beside."""

from typing import Any

import numpy as np

from pipeline.report.judge.errors import scores


def baselines(steering_rad: np.ndarray, previous_rad: np.ndarray, train_mean_rad: float) -> dict[str, dict[str, Any]]:
    """Return the scores of three predictors that see nothing of the road.

    zero: always straight. train_mean: the mean of the training labels. persistence: the true angle of the last valid
    frame before, `previous_rad` [N] (NaN where there is none: zero is predicted); it knows what no model is told.
    """
    constant = np.full_like(steering_rad, train_mean_rad)
    return {
        "zero": scores(steering_rad, np.zeros_like(steering_rad)),
        "train_mean": scores(steering_rad, constant),
        "persistence": scores(steering_rad, np.nan_to_num(previous_rad)),
    }


def last_valid(steering_rad: np.ndarray, valid: np.ndarray) -> np.ndarray:
    """Return for each frame [F] of a drive the label of the last valid frame before it, NaN where there is none."""
    rows = np.where(valid, np.arange(len(valid)), -1)
    before = np.concatenate([[-1], np.maximum.accumulate(rows)[:-1]]) if len(rows) else rows
    return np.where(before >= 0, steering_rad[before], np.nan)
