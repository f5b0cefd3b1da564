"""Compute errors of predictions and their confidence intervals.

One column at a time, in rad or 1/m. Predictions are [N], or [S,N] for S seeds, over which errors are averaged.
"""

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from pipeline.base.errors import InputError
from pipeline.base.metrics import mae, mse, nmse, rmse
from pipeline.evaluate.settings import Evaluate

LEAST_DRIVES = 10  # for a verdict
METRICS: dict[str, Callable[[np.ndarray, np.ndarray], float | None]] = {
    "mae": mae,
    "mse": mse,
    "nmse": nmse,
    "rmse": rmse,
}
"""Name → function of true values [N] and predictions, [N] or [S,N] of S seeds. Your own metric is one more."""


def scores(truth: np.ndarray, predicted: np.ndarray) -> dict[str, Any]:
    """Return frames, and the METRICS of predictions for true values [N].

    Without frames, or if a prediction is NaN, all are None. Raises InputError if a metric returns another number.
    """
    if not len(truth) or np.isnan(predicted).any():
        return {"frames": 0, **dict.fromkeys(METRICS)}
    result: dict[str, Any] = {"frames": len(truth)}
    for name, metric in METRICS.items():
        value = metric(truth, predicted)
        if value is not None and not math.isfinite(value):
            fix = "Return a finite number, or None where there is none"
            raise InputError(f"metric {name} returned {value}", "pipeline/evaluate/statistics.py", fix)
        result[name] = value
    return result


def interval(
    error: np.ndarray, truth: np.ndarray, drive: np.ndarray, settings: Evaluate, other: np.ndarray | None = None
) -> list[float] | None:
    """Return the 95 % interval of Σ error / Σ truth² over other roads and seeds, from a bootstrap.

    The :func:`parts` of drives are drawn with replacement, and independently the seeds of each model. n values have a
    variance that is too small by (n - 1) / n, so deviations from the mean are multiplied by √(n / (n - 1)), for seeds
    as for parts. With one seed the interval is of these networks only. None with one part, or if every true value is 0.

    Args:
        error: squared errors [S,N] of S seeds, for all frames in time order, NaN for those that do not count; [S,N,R]
            for the interval of the mean over R columns.
        truth: [N] or [N,R], true values.
        drive: [N], the number of each frame's drive.
        other: squared errors of a second model, for the paired difference, narrower if both err on the same roads.
    """
    models = [truth[None] ** 2, error] if other is None else [truth[None] ** 2, error, other]
    models = [values.reshape(*values.shape[:2], -1) for values in models]  # [S,N,R]
    counted = np.all([np.isfinite(values).all(axis=0) for values in models], axis=0)  # [N,R]
    rows = counted.any(axis=1)
    _, first = np.unique(parts(drive, settings.bootstrap_block_frames)[rows], return_index=True)
    if len(first) < 2:
        return None
    models = [np.add.reduceat(np.where(counted, values, 0.0)[:, rows], first, axis=1) for values in models]  # [S,D,R]
    (zero,), *sums = (values[..., models[0].any(axis=(0, 1))] for values in models)
    if not zero.size:
        return None
    rng, samples = np.random.default_rng(settings.seed), settings.bootstrap_samples
    count, drawn, mean = len(zero), np.zeros((samples, zero.shape[1])), 0.0
    drives = rng.multinomial(count, np.full(count, 1 / count), samples)  # how often each is drawn
    for sign, values in zip((1, -1), sums, strict=False):
        n = len(values)
        seeds = 1 + math.sqrt(n / max(n - 1, 1)) * (rng.multinomial(n, np.full(n, 1 / n), samples) - 1)
        drawn += sign * np.einsum("bs,bsr->br", seeds, np.einsum("bd,sdr->bsr", drives, values)) / n
        mean += sign * (values.mean(axis=0).sum(axis=0) / zero.sum(axis=0)).mean()
    zeros = np.einsum("bd,dr->br", drives, zero)
    drawn = np.divide(drawn, zeros, out=np.full_like(drawn, np.nan), where=zeros > 0).mean(axis=1)
    bounds = mean + math.sqrt(count / (count - 1)) * (np.nanpercentile(drawn, [2.5, 97.5]) - mean)
    return [float(bound) for bound in (bounds.clip(min=0.0) if other is None else bounds)]


def parts(drive: np.ndarray, block_frames: int) -> np.ndarray:
    """Return the number [N] of the part of each frame, for the numbers [N] of the frames' drives.

    A drive of two or more blocks is cut into equal parts of at least one block, which count as drives.
    """
    drives = np.split(drive, np.flatnonzero(np.diff(drive)) + 1)
    lengths = [len(part) for rows in drives for part in np.array_split(rows, max(len(rows) // block_frames, 1))]
    return np.repeat(np.arange(len(lengths)), lengths)


def verdict(bounds: Sequence[float] | None, seeds: int, drives: int) -> str:
    """Return what the :func:`interval` of a paired difference shows about the first of two methods.

    `seeds`: of the model that has fewer; `drives`: the :func:`parts`.
    """
    if seeds < 2:
        return "too few seeds"
    if drives < LEAST_DRIVES:
        return "too few drives"
    low, high = bounds or (-math.inf, math.inf)
    return "better" if high < 0 else "worse" if low > 0 else "no difference shown"


def untrained(nmse: np.ndarray) -> list[int]:
    """Return which seeds failed to train, by the nmse [S] of each on its own training drives."""
    return np.flatnonzero((nmse > 0.9) | (nmse > 0.5) & (nmse > 2 * np.median(nmse))).tolist()


def interval_text(bounds: Sequence[float] | None, form: str = ".3f") -> str:
    """Return the bounds of an :func:`interval` as text, the reason if it is None."""
    return "too short for an interval" if bounds is None else " to ".join(format(bound, form) for bound in bounds)
