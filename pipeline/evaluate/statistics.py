"""Compute errors of predictions and their confidence intervals.

Values are in rad or 1/m. Letters: N frames, S seeds of a model, R columns (the steering angle, or
ranges of the path ahead), D parts of drives, B draws of the bootstrap. Predictions are [N], or
[S,N] for S seeds, over which errors are averaged.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from pipeline.evaluate.settings import Evaluate

# Least number of independent parts of drives for a verdict on two methods.
LEAST_DRIVES = 10


def nmse_of(error: np.ndarray, truth: np.ndarray) -> float | None:
    """Return Σ error / Σ truth², as the mean over seeds and columns.

    `error` [S,N,R] holds squared errors, NaN for frames that do not count, and `truth` [N,R] true
    values. Columns whose true values are all 0 do not count. The result is None if no column
    counts.
    """
    # The error of always predicting zero.
    zero_error = np.nansum(truth**2, axis=0)
    bends = zero_error > 0
    if not bends.any():
        return None
    return float((np.nansum(error.mean(axis=0), axis=0)[bends] / zero_error[bends]).mean())


def bootstrap_interval(
    error: np.ndarray,
    truth: np.ndarray,
    drive: np.ndarray,
    settings: Evaluate,
    other: np.ndarray | None = None,
) -> list[float] | None:
    """Return the 95 % interval of Σ error / Σ truth² over other roads and seeds, from a bootstrap.

    Parts of drives (:func:`number_parts`) are drawn with replacement, and so are the seeds of each
    model, independently of the parts. The variance of n drawn values is too small by a factor of
    (n - 1) / n. So deviations from the mean are multiplied by √(n / (n - 1)), for seeds as for
    parts. With one seed, the interval does not include the spread of other seeds. The result is
    None with fewer than two parts, or if every true value is 0.

    Args:
        error: squared errors [S,N] of S seeds, for all frames in time order, NaN for frames that do
            not count. They are [S,N,R] for the interval of the mean over R columns.
        truth: true values [N] or [N,R].
        drive: number [N] of each frame's drive.
        settings: number of draws, frames of a part, and seed of the draws.
        other: squared errors of a second model. With them, the interval is that of the paired
            difference, which is narrower if both models err on the same roads.
    """
    # Sum the squared errors of the models, and of always predicting zero, over the frames of each
    # part that count.
    squares = (truth**2).reshape(1, len(truth), -1)  # [1,N,R]
    models = [error.reshape(*error.shape[:2], -1)]
    if other is not None:
        models.append(other.reshape(*other.shape[:2], -1))
    counted = np.isfinite(squares).all(axis=0)  # [N,R]
    for values in models:
        counted &= np.isfinite(values).all(axis=0)
    part = number_parts(drive, settings.bootstrap_block_frames)
    zero_error = sums_by_part(squares, counted, part)[0]  # [D,R]
    errors = [sums_by_part(values, counted, part) for values in models]  # each [S,D,R]

    # A column whose true values are all 0 has no nmse.
    bends = zero_error.any(axis=0)
    if len(zero_error) < 2 or not bends.any():
        return None
    zero_error = zero_error[:, bends]
    errors = [values[..., bends] for values in errors]

    # Compute the error of the first model on drawn parts and with drawn seeds, and subtract that of
    # the second model, if given.
    rng = np.random.default_rng(settings.seed)
    samples = settings.bootstrap_samples
    drawn_parts = draw_counts(len(zero_error), samples, rng)
    drawn = drawn_error(errors[0], drawn_parts, draw_seeds(len(errors[0]), samples, rng))
    mean = mean_nmse(errors[0], zero_error)
    if len(errors) > 1:
        drawn -= drawn_error(errors[1], drawn_parts, draw_seeds(len(errors[1]), samples, rng))
        mean -= mean_nmse(errors[1], zero_error)

    # Divide by the error of always predicting zero on the drawn parts. The result is NaN for a draw
    # whose true values are all 0.
    drawn_zero = np.einsum("bd,dr->br", drawn_parts, zero_error)
    drawn_nmse = np.full_like(drawn, np.nan)
    np.divide(drawn, drawn_zero, out=drawn_nmse, where=drawn_zero > 0)
    percentiles = np.nanpercentile(drawn_nmse.mean(axis=1), [2.5, 97.5])

    # An error is never below 0, but a difference can be.
    low, high = (mean + widening_factor(len(zero_error)) * (percentiles - mean)).tolist()
    if other is None:
        return [max(low, 0.0), max(high, 0.0)]
    return [low, high]


def sums_by_part(values: np.ndarray, counted: np.ndarray, part: np.ndarray) -> np.ndarray:
    """Return the sums [S,D,R] of `values` [S,N,R] over the frames of each part.

    `counted`, bool [N,R], tells which values count, and `part` [N] is the number of each frame's
    part, ascending. Parts in which no value counts are left out.
    """
    rows = counted.any(axis=1)
    _, first = np.unique(part[rows], return_index=True)
    if not len(first):
        return np.zeros((len(values), 0, values.shape[-1]))
    # The rows of a part are consecutive, so a sum ends where the next part begins.
    return np.add.reduceat(np.where(counted, values, 0.0)[:, rows], first, axis=1)


def draw_counts(count: int, samples: int, rng: np.random.Generator) -> np.ndarray:
    """Draw `count` times from `count` items with replacement, and repeat this `samples` times.

    Returns how often each item is drawn, [samples,count].
    """
    return rng.multinomial(count, np.full(count, 1 / count), samples)


def draw_seeds(count: int, samples: int, rng: np.random.Generator) -> np.ndarray:
    """Draw seeds, and return the weight of each seed in a mean over them, [samples,count].

    The deviations of the weights from 1 are multiplied by the :func:`widening_factor`.
    """
    return 1 + widening_factor(count) * (draw_counts(count, samples, rng) - 1)


def widening_factor(count: int) -> float:
    """Return the factor by which deviations of a mean over `count` drawn items are too small."""
    return math.sqrt(count / max(count - 1, 1))


def drawn_error(errors: np.ndarray, drawn_parts: np.ndarray, seeds: np.ndarray) -> np.ndarray:
    """Return the error [B,R] of each draw of parts and seeds.

    `errors` [S,D,R] are sums over the frames of each part, `drawn_parts` [B,D] tells how often a
    part is drawn, and `seeds` [B,S] are the weights of the seeds.
    """
    by_seed = np.einsum("bd,sdr->bsr", drawn_parts, errors)
    return np.einsum("bs,bsr->br", seeds, by_seed) / len(errors)


def mean_nmse(errors: np.ndarray, zero_error: np.ndarray) -> float:
    """Return the nmse over all parts, as the mean over seeds and columns.

    `errors` [S,D,R] are the sums of a model's squared errors by part, and `zero_error` [D,R] those
    of always predicting zero.
    """
    return float((errors.mean(axis=0).sum(axis=0) / zero_error.sum(axis=0)).mean())


def number_parts(drive: np.ndarray, block_frames: int) -> np.ndarray:
    """Return the number [N] of each frame's part, by the number [N] of its drive.

    A short drive is one part. A drive of at least two blocks of `block_frames` frames is cut into
    equal parts of at least one block each.
    """
    lengths = []
    for frames in np.split(drive, np.flatnonzero(np.diff(drive)) + 1):
        blocks = max(len(frames) // block_frames, 1)
        lengths += [len(part) for part in np.array_split(frames, blocks)]
    return np.repeat(np.arange(len(lengths)), lengths)


def judge_difference(bounds: Sequence[float] | None, seeds: int, drives: int) -> str:
    """Return what the interval of a paired difference shows about the first of two methods.

    `bounds` is the :func:`bootstrap_interval`, `seeds` the number of seeds of the model that has
    fewer, and `drives` the number of parts of drives.
    """
    if seeds < 2:
        return "too few seeds (train.seeds)"
    if drives < LEAST_DRIVES:
        return "too few drives"
    if bounds is not None and bounds[1] < 0:
        return "better"
    if bounds is not None and bounds[0] > 0:
        return "worse"
    return "no difference shown"


def find_untrained(nmse: np.ndarray) -> list[int]:
    """Return the rows of the seeds that failed to train, by their nmse [S] on the training drives.

    A seed failed if its nmse is above 0.9, or above both 0.5 and twice the median of all seeds.
    """
    return np.flatnonzero((nmse > 0.9) | (nmse > 0.5) & (nmse > 2 * np.median(nmse))).tolist()


def nmse_text(row: Mapping[str, Any], digits: int = 3) -> str:
    """Return the nmse of a row of errors, with its deviation over seeds and its interval."""
    if pd.isna(row.get("nmse")):
        return "unknown"
    text = f"{row['nmse']:.{digits}f}"
    if len(row["seeds"]) > 1:
        text += f" ± {np.std(row['seeds'], ddof=1):.{digits}f}"
    return f"{text} ({bounds_text(row, f'.{digits}f')})"


def bounds_text(row: Mapping[str, Any], form: str) -> str:
    """Return the interval of a row of errors or differences as text."""
    bounds = None if pd.isna(row.get("low")) else [row["low"], row["high"]]
    return interval_text(bounds, form)


def interval_text(bounds: Sequence[float] | None, form: str = ".3f") -> str:
    """Return the bounds of an :func:`bootstrap_interval` as text, or the reason if it is None."""
    if bounds is None:
        return "too short for an interval"
    low, high = bounds
    return f"{low:{form}} to {high:{form}}"
