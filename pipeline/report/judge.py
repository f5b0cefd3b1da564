"""Steering errors, the trivial predictors beside them, and how sure one can be. Angles in rad unless named deg."""

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np


def scores(steering_rad: np.ndarray, predicted_rad: np.ndarray) -> dict[str, Any]:
    """Return mse_rad2, rmse_deg, mae_deg and nmse of predictions [N], or of S seeds' predictions [S,N] on average.

    nmse = MSE / MSE of always predicting zero: 1 is useless, 0 perfect, None where every label is 0.
    """
    error = predicted_rad - steering_rad
    mse = float(np.mean(error**2))
    zero = float(np.mean(steering_rad**2))
    return {
        "frames": len(steering_rad),
        "mse_rad2": mse,
        "rmse_deg": float(np.rad2deg(np.sqrt(mse))),
        "mae_deg": float(np.rad2deg(np.mean(np.abs(error)))),
        "nmse": mse / zero if zero > 0 else None,
    }


def nmse_std(steering_rad: np.ndarray, predicted_rad: np.ndarray) -> float | None:
    """Return the standard deviation of nmse over seeds, from predictions [S,N]; None of one seed."""
    found = [scores(steering_rad, of_seed)["nmse"] for of_seed in predicted_rad]
    return float(np.std(found, ddof=1)) if len(found) > 1 and None not in found else None


def nmse_interval(
    steering_rad: np.ndarray, predicted_rad: np.ndarray, drive: np.ndarray, block: int, samples: int, seed: int
) -> tuple[float, float]:
    """Return the 95 % interval of nmse by a moving-block bootstrap.

    Neighbouring frames err alike, so whole blocks of `block` consecutive rows are drawn, each from within one drive.

    Args:
        steering_rad, drive: [N] in time order; `drive` numbers the drives.
        predicted_rad: [N], or [S,N] of S seeds, whose errors are averaged frame by frame: the interval is then that of
            their mean nmse on other roads, given these networks.
        block: rows per block; a drive that is shorter is a block of its own.
        samples: bootstrap samples.
    """
    first = np.flatnonzero(np.diff(drive, prepend=drive[0] - 1))  # [D] where drives begin
    length = np.minimum(block, np.diff(first, append=len(drive)))  # a drive shorter than a block is one
    last = np.append(first[1:], len(drive)) - length  # [D] the last start of a block
    starts = np.concatenate([np.arange(a, b + 1) for a, b in zip(first, last, strict=True)])
    length = np.repeat(length, last - first + 1)
    error = np.atleast_2d((predicted_rad - steering_rad) ** 2).mean(axis=0)
    squared = np.stack([error, steering_rad**2])  # [2,N]
    sums = np.concatenate([np.zeros((2, 1)), np.cumsum(squared, axis=1)], axis=1)
    of_block = sums[:, starts + length] - sums[:, starts]  # [2,S]
    count = int(np.ceil(len(drive) / length.mean()))
    draws = np.random.default_rng(seed).integers(len(starts), size=(samples, count))
    errors, zeros = of_block[:, draws].sum(axis=2)  # [samples] each
    with np.errstate(divide="ignore", invalid="ignore"):
        low, high = np.nanpercentile(np.where(zeros > 0, errors / zeros, np.nan), [2.5, 97.5])
    return float(low), float(high)


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


def by_curvature(
    steering_rad: np.ndarray, predicted_rad: np.ndarray, curvature_1pm: np.ndarray, edges: Sequence[float]
) -> list[dict[str, Any]]:
    """Return the scores within bins of |curvature|, straightest first: a model that only drives straight shows here.

    Beside them, as `zero`, those of always predicting zero. A bin without a frame has `frames` 0 and nothing else.
    """
    bounds = [0.0, *edges, np.inf]
    rows = []
    for low, high in pairwise(bounds):
        inside = (np.abs(curvature_1pm) >= low) & (np.abs(curvature_1pm) < high)
        row: dict[str, Any] = {"from_1pm": low, "to_1pm": None if np.isinf(high) else high, "frames": 0}
        if inside.any():
            row |= scores(steering_rad[inside], predicted_rad[..., inside])
            row["zero"] = scores(steering_rad[inside], np.zeros(inside.sum()))
        rows.append(row)
    return rows
