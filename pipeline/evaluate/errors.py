"""Compute errors of predictions, their confidence intervals, and scores of predicted standard deviations.

One column at a time, in its unit: rad, or 1/m. Predictions are [N], or [S,N] for S seeds, over which errors are
averaged.
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from pipeline.settings.evaluate import Evaluate


def scores(truth: np.ndarray, predicted: np.ndarray) -> dict[str, Any]:
    """Return frames, mse, rmse, mae and nmse of predictions for true values [N].

    nmse = MSE / MSE of always predicting zero: 0 is perfect, 1 is useless, None if every true value is 0. Without
    frames, or if a prediction is NaN, all errors are None.
    """
    if not len(truth) or np.isnan(predicted).any():
        return {"frames": 0, **dict.fromkeys(("mse", "rmse", "mae", "nmse"))}
    error = predicted - truth
    mse, zero = float(np.mean(error**2)), float(np.mean(truth**2))
    return {
        "frames": len(truth),
        "mse": mse,
        "rmse": float(np.sqrt(mse)),
        "mae": float(np.mean(np.abs(error))),
        "nmse": mse / zero if zero > 0 else None,
    }


def interval(error: np.ndarray, truth: np.ndarray, drive: np.ndarray, settings: Evaluate) -> list[float] | None:
    """Return the 95 % interval of Σ error / Σ truth² over other roads, from a circular block bootstrap of drives.

    None if the counted frames fit into one block: each draw would be the same, and an interval of zero width claims
    certainty. None also if every true value is 0.

    Drives are drawn with replacement, and within each drawn drive blocks of consecutive frames, since errors of
    neighbouring frames are correlated. A block that passes the end of its drive continues at its start, so that all
    frames are drawn equally often. A drive that is not longer than a block is drawn completely.

    Args:
        error: [N] for all frames in time order, NaN for those that do not count: they keep their place in a block.
            Squared errors of a model, for the interval of its nmse. For the interval of a difference in nmse, the
            difference of two models' squared errors: it is narrower if both have their errors on the same roads. Means
            over seeds give an interval for these networks. [N,R] for the interval of the mean over R columns.
        truth: [N] or [N,R], true values.
        drive: [N], the number of each frame's drive.
    """
    counted = np.isfinite(error)
    values = np.where(counted, [error, truth**2], 0.0).reshape(2, len(drive), -1).swapaxes(1, 2)  # [2,R,N]
    values = values[:, values[1].any(axis=1)]
    if not values.size:
        return None
    first = np.flatnonzero(np.diff(drive, prepend=drive[0] - 1))  # [D] first row of each drive
    rows = np.diff(first, append=len(drive))  # [D]
    blocks = -(-rows // settings.bootstrap_block_frames)  # [D] of equal length, which together cover the drive
    counts = np.add.reduceat(counted.reshape(len(drive), -1).any(axis=1), first, dtype=int)  # [D]
    if (-(-counts // settings.bootstrap_block_frames)).sum() < 2:
        return None
    length = np.round(rows / blocks).astype(int)
    parts = zip(np.split(values, first[1:], axis=2), length, strict=True)
    block_sums = np.concatenate([_circular_sums(part, size) for part, size in parts], axis=2)  # over the next block
    rng = np.random.default_rng(settings.seed)
    drawn = rng.integers(len(first), size=(settings.bootstrap_samples, len(first)))
    sums = np.zeros((*values.shape[:2], len(drawn)))
    for block in range(blocks.max()):
        start = first[drawn] + rng.integers(rows[drawn])
        sums += (block_sums[:, :, start] * (block < blocks[drawn])).sum(axis=-1)
    errors, zeros = np.where(sums[1] > 0, sums, np.nan)
    low, high = np.nanpercentile((errors / zeros).mean(axis=0), [2.5, 97.5])
    return [float(low), float(high)]


def interval_text(bounds: Sequence[float] | None, form: str = ".3f") -> str:
    """Return the bounds of an :func:`interval` as text, the reason if it is None."""
    return "too short for an interval" if bounds is None else " to ".join(format(bound, form) for bound in bounds)


def _circular_sums(values: np.ndarray, length: int) -> np.ndarray:
    """Return the sums of `length` consecutive values along the last axis, from each one, continued at the first."""
    before = np.zeros_like(values[..., :1])
    repeated = np.concatenate([before, values, values[..., : length - 1]], axis=-1).cumsum(axis=-1)
    return repeated[..., length:] - repeated[..., : values.shape[-1]]


def uncertainty(
    truth: np.ndarray, predicted: np.ndarray, sigma: np.ndarray, half_95: np.ndarray
) -> dict[str, float] | None:
    """Return means over S seeds' predictions [S,N] with standard deviations and halves of 95 % intervals [S,N].

    - nll: mean negative log-likelihood of a normal distribution, in nats; nll_constant: the same with one σ for all
      frames, the RMSE on these frames, which is the best constant.
    - coverage_68, coverage_95: share of true values within ±σ of the prediction, and in its 95 % interval.
    - mae_certain: mean error of the half with the smaller σ.
    """
    if not len(truth):
        return None
    error = np.abs(predicted - truth)
    rmse = np.sqrt(np.mean(error**2, axis=1, keepdims=True))
    by_sigma = np.take_along_axis(error, np.argsort(sigma, axis=1), axis=1)
    return {
        "nll": _nll(error, sigma),
        "nll_constant": _nll(error, np.broadcast_to(rmse, error.shape)),
        "coverage_68": float(np.mean(error <= sigma)),
        "coverage_95": float(np.mean(error <= half_95)),
        "mae_certain": float(by_sigma[:, : (error.shape[1] + 1) // 2].mean()),
    }


def _nll(error: np.ndarray, sigma: np.ndarray) -> float:
    return float(np.mean(np.log(sigma) + (error / sigma) ** 2 / 2 + math.log(2 * math.pi) / 2))
