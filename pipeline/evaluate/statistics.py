"""Compute errors of predictions and their confidence intervals.

Letters: N frames, S seeds of a model, C columns of errors, D parts of drives, B draws of the
bootstrap.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from pipeline.evaluate.settings import Evaluate
from pipeline.train.quantity import Measure

# Least number of independent parts of drives for a verdict on two methods.
LEAST_DRIVES = 10
# Verdict if there are fewer.
TOO_FEW_DRIVES = "too few drives"
# Share of a block by which the last part of a drive may be shorter, since times are rounded.
BLOCK_TOLERANCE = 1e-3
# Largest number of decimal places that a small error gets beyond those of its measure.
FURTHER_DIGITS = 3


class FrameErrors(NamedTuple):
    """Errors of a method in each frame, in time order.

    The error of the method is Σ error / Σ weight over frames, as the mean over seeds and columns.
    """

    error: np.ndarray  # [S,N,C], NaN in frames that do not count
    weight: np.ndarray  # [N,C], NaN in frames that do not count

    @property
    def counted(self) -> np.ndarray:
        """Whether a frame counts in a column, bool [N,C]."""
        return np.isfinite(self.weight)


def count_frames(error: np.ndarray, weight: np.ndarray) -> FrameErrors:
    """Return errors [S,N,C] and weights [N,C] in the frames that have both, with every seed."""
    counted = np.isfinite(error).all(axis=0) & np.isfinite(weight)
    return FrameErrors(np.where(counted, error, np.nan), np.where(counted, weight, np.nan))


def mean_error(errors: FrameErrors) -> float | None:
    """Return Σ error / Σ weight, or None if no column has a weight."""
    shares = contributions(errors)
    return None if shares is None else float(shares.sum())


def contributions(errors: FrameErrors) -> np.ndarray | None:
    """Return the part [N] that each frame has in the :func:`mean_error`.

    Columns whose weights are all 0 do not count. The result is None if no column counts.
    """
    weight = np.nansum(errors.weight, axis=0)
    has_weight = weight > 0
    if not has_weight.any():
        return None
    error = np.nan_to_num(errors.error.mean(axis=0))[:, has_weight]
    return (error / weight[has_weight]).mean(axis=1)


def find_worst(errors: FrameErrors, drive: np.ndarray) -> tuple[int, float] | None:
    """Return the drive with the largest share of the :func:`mean_error`, and that share.

    `drive` [N] is the number of each frame's drive. The result is None without an error.
    """
    shares = contributions(errors)
    if shares is None or not shares.sum() > 0:
        return None
    by_drive = np.bincount(drive, shares)
    return int(by_drive.argmax()), float(by_drive.max() / shares.sum())


def bootstrap_interval(
    errors: FrameErrors,
    part: np.ndarray,
    settings: Evaluate,
    other: FrameErrors | None = None,
) -> list[float] | None:
    """Return the 95 % interval of Σ error / Σ weight over other roads and seeds, from a bootstrap.

    Parts of drives are drawn with replacement, and so are the seeds of each
    model, independently of the parts. The variance of n drawn values is too small by a factor of
    (n - 1) / n. So deviations from the mean are multiplied by √(n / (n - 1)), for seeds as for
    parts. With one seed, the interval does not include the spread of other seeds. The result is
    None with fewer than two parts, or if every weight is 0.

    Args:
        errors: errors of a model.
        part: number [N] of each frame's part of a drive, see :func:`number_parts`.
        settings: number and seed of the draws.
        other: errors of a second model, with the same weights. With them, the interval is that of
            the paired difference, which is narrower if both models err on the same roads.
    """
    # Sum errors and weights over the frames of each part that count.
    models = [errors] if other is None else [errors, other]
    counted = np.all([model.counted for model in models], axis=0)  # [N,C]
    weight = sums_by_part(errors.weight[None], counted, part)[0]  # [D,C]
    sums = [sums_by_part(model.error, counted, part) for model in models]  # each [S,D,C]

    # A column whose weights are all 0 has no error.
    has_weight = weight.any(axis=0)
    if len(weight) < 2 or not has_weight.any():
        return None
    weight = weight[:, has_weight]
    sums = [values[..., has_weight] for values in sums]

    # Sum the errors of the first model over drawn parts and drawn seeds, and subtract those of the
    # second model, if given.
    rng = np.random.default_rng(settings.seed)
    samples = settings.bootstrap_samples
    drawn_parts = draw_counts(len(weight), samples, rng)
    drawn = drawn_error(sums[0], drawn_parts, draw_seeds(len(sums[0]), samples, rng))
    total = sums[0].mean(axis=0).sum(axis=0)  # [C]
    if len(sums) > 1:
        drawn -= drawn_error(sums[1], drawn_parts, draw_seeds(len(sums[1]), samples, rng))
        total -= sums[1].mean(axis=0).sum(axis=0)
    mean = (total / weight.sum(axis=0)).mean()

    # Divide by the weights of the drawn parts. The result is NaN for a draw whose weights are all
    # 0.
    drawn_weight = np.einsum("bd,dc->bc", drawn_parts, weight)
    drawn_mean = np.full_like(drawn, np.nan)
    np.divide(drawn, drawn_weight, out=drawn_mean, where=drawn_weight > 0)
    percentiles = np.nanpercentile(drawn_mean.mean(axis=1), [2.5, 97.5])

    # An error is never below 0, but a difference can be.
    low, high = (mean + widening_factor(len(weight)) * (percentiles - mean)).tolist()
    if other is None:
        return [max(low, 0.0), max(high, 0.0)]
    return [low, high]


def sums_by_part(values: np.ndarray, counted: np.ndarray, part: np.ndarray) -> np.ndarray:
    """Return the sums [S,D,C] of `values` [S,N,C] over the frames of each part.

    `counted`, bool [N,C], tells which values count, and `part` [N] is the number of each frame's
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
    """Return the sum of errors [B,C] of each draw of parts and seeds.

    `errors` [S,D,C] are sums over the frames of each part, `drawn_parts` [B,D] tells how often a
    part is drawn, and `seeds` [B,S] are the weights of the seeds.
    """
    by_seed = np.einsum("bd,sdc->bsc", drawn_parts, errors)
    return np.einsum("bs,bsc->bc", seeds, by_seed) / len(errors)


def number_parts(drive: np.ndarray, time_s: np.ndarray, block_s: float) -> np.ndarray:
    """Return the number [N] of each frame's part, by the number [N] of its drive and its time [N].

    A short drive is one part. A drive of at least two blocks of `block_s` is cut into parts of
    equally many frames, of at least one block each. Time in which the drive has no frames does not
    count.
    """
    lengths = []
    for times_s in np.split(time_s, np.flatnonzero(np.diff(drive)) + 1):
        blocks = math.floor(drive_length_s(times_s) / block_s + BLOCK_TOLERANCE)
        lengths += [len(part) for part in np.array_split(times_s, max(blocks, 1))]
    return np.repeat(np.arange(len(lengths)), lengths)


def drive_length_s(time_s: np.ndarray) -> float:
    """Return how long a drive is that has frames at some times [F], without its gaps.

    The last frame lasts as long as the others. A step of more than twice the median is a gap.
    """
    if len(time_s) < 2:
        return 0.0
    steps_s = np.diff(time_s)
    return len(time_s) * float(steps_s[steps_s <= 2 * np.median(steps_s)].mean())


def judge_difference(bounds: Sequence[float] | None, seeds: int, drives: int, digits: int) -> str:
    """Return what the interval of a paired difference shows about the first of two methods.

    `bounds` is the :func:`bootstrap_interval`, `seeds` the number of seeds of the model that has
    fewer, and `drives` the number of parts of drives. `digits` are the decimal places of the bounds
    in tables: a bound that is 0 there excludes nothing.
    """
    if drives < LEAST_DRIVES:
        return TOO_FEW_DRIVES
    if seeds < 2:
        return "too few seeds"
    if bounds is not None and round(bounds[1], digits) < 0:
        return "better"
    if bounds is not None and round(bounds[0], digits) > 0:
        return "worse"
    return "no difference shown"


def find_untrained(nmse: np.ndarray, mean_nmse: float) -> list[int]:
    """Return the rows of the seeds that failed to train, by their nmse [S] on the training drives.

    Errors count relative to that of always predicting zero, or the mean, of which `mean_nmse` is
    the nmse, whichever is smaller: to predict the mean of a speed is no achievement. A seed failed
    if this ratio is above 0.9, or above both 0.5 and twice the median of all seeds.
    """
    ratio = nmse / min(mean_nmse, 1.0)
    return np.flatnonzero((ratio > 0.9) | (ratio > 0.5) & (ratio > 2 * np.median(ratio))).tolist()


def error_text(row: Mapping[str, Any], measure: Measure) -> str:
    """Return the error of a row with its deviation over seeds and its interval, without a unit."""
    value = value_of(row)
    if value is None:
        return "unknown"
    text = number_text(value, measure)
    if len(row["seeds"]) > 1:
        text += f" ± {number_text(np.std(row['seeds'], ddof=1), measure)}"
    return f"{text} ({error_bounds_text(row, measure)})"


def value_of(row: Mapping[str, Any]) -> float | None:
    """Return the error of a row, which is in column nmse or error."""
    for column in ("nmse", "error"):
        if not pd.isna(row.get(column)):
            return float(row[column])
    return None


def number_text(value: float, measure: Measure) -> str:
    """Return an error as text, with further decimal places if it would print as 0 but is not 0."""
    digits = measure.digits
    while round(value, digits) == 0 and value != 0 and digits < measure.digits + FURTHER_DIGITS:
        digits += 1
    if round(value, digits) == 0:
        digits = measure.digits
    return format(value, f"z.{digits}f")


def error_bounds_text(row: Mapping[str, Any], measure: Measure) -> str:
    """Return the interval of a row of errors as text."""
    if pd.isna(row.get("low")):
        return no_interval_text(row)
    return f"{number_text(row['low'], measure)} to {number_text(row['high'], measure)}"


def bounds_text(row: Mapping[str, Any], form: str) -> str:
    """Return the interval of a row of differences as text, with the digits of their verdict."""
    if pd.isna(row.get("low")):
        return no_interval_text(row)
    return f"{signed_text(row['low'], form)} to {signed_text(row['high'], form)}"


def no_interval_text(row: Mapping[str, Any]) -> str:
    """Return why a row has no interval. Rows of differences have no number of drives."""
    return "one test drive: no interval" if row.get("drives") == 1 else "no interval"


def signed_text(value: float, form: str) -> str:
    """Return a difference as text. A difference that prints as 0 has no sign."""
    text = format(value, form)
    return text if text.strip("+-0.") else text.lstrip("+-")
