"""Compute errors of predictions and their confidence intervals.

One column at a time, in rad or 1/m. Predictions are [N], or [S,N] for S seeds, over which errors
are averaged.
"""

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from pipeline.base.errors import InputError
from pipeline.base.metrics import mae, mse, nmse, rmse
from pipeline.evaluate.settings import Evaluate

# Least number of independent parts of drives for a verdict on two methods.
LEAST_DRIVES = 10


class Metric(NamedTuple):
    """An error of predictions, [N] or [S,N] of S seeds, for true values [N].

    It is None where it is not defined.
    """

    compute: Callable[[np.ndarray, np.ndarray], float | None]
    # Whether tables, page and DVC's metrics show it beside nmse and the mean error in degrees.
    shown: bool = True


# All are in metrics.json. Your own metric is one more entry.
METRICS: dict[str, Metric] = {
    "mae": Metric(mae, shown=False),
    "mse": Metric(mse, shown=False),
    "nmse": Metric(nmse, shown=False),
    "rmse": Metric(rmse, shown=False),
}


def shown_metrics() -> list[str]:
    """Return the names of the METRICS that tables show."""
    return [name for name, metric in METRICS.items() if metric.shown]


def scores(truth: np.ndarray, predicted: np.ndarray) -> dict[str, Any]:
    """Return frames, and the METRICS of predictions for true values [N].

    Without frames, or if a prediction is NaN, all are None. Raises InputError if a metric returns
    another number.
    """
    if not len(truth) or np.isnan(predicted).any():
        return {"frames": 0, **dict.fromkeys(METRICS)}
    result: dict[str, Any] = {"frames": len(truth)}
    for name, metric in METRICS.items():
        value = metric.compute(truth, predicted)
        if value is not None and not math.isfinite(value):
            problem = f"metric {name} returned {value}"
            fix = "Return a finite number, or None where there is none"
            raise InputError(problem, "pipeline/evaluate/statistics.py", fix)
        result[name] = None if value is None else float(value)
    return result


def errors(
    truth: np.ndarray, predicted: np.ndarray, drive: np.ndarray, settings: Evaluate
) -> dict[str, Any]:
    """Return the :func:`scores` of predictions [S,N], the nmse of each seed, and its interval.

    Frames whose truth or prediction is NaN do not count. `truth`, `drive`: [N] as in
    :func:`interval`.
    """
    error = (predicted - truth) ** 2
    counted = np.isfinite(error).all(axis=0)
    by_seed = [scores(truth[counted], seed[counted])["nmse"] for seed in predicted]
    return scores(truth[counted], predicted[:, counted]) | {
        "nmse_ci95": interval(error, truth, drive, settings),
        "nmse_by_seed": by_seed,
    }


def nmse_of(error: np.ndarray, truth: np.ndarray) -> float | None:
    """Return Σ error / Σ truth², the mean over seeds and columns; None if every true value is 0.

    `error`: squared errors [S,N,R], NaN for frames that do not count; `truth`: [N,R].
    """
    zero = np.nansum(truth**2, axis=0)
    bends = zero > 0
    if not bends.any():
        return None
    return float((np.nansum(error.mean(axis=0), axis=0)[bends] / zero[bends]).mean())


def interval(
    error: np.ndarray,
    truth: np.ndarray,
    drive: np.ndarray,
    settings: Evaluate,
    other: np.ndarray | None = None,
) -> list[float] | None:
    """Return the 95 % interval of Σ error / Σ truth² over other roads and seeds, from a bootstrap.

    The :func:`parts` of drives are drawn with replacement, and independently the seeds of each
    model. n values have a variance that is too small by (n - 1) / n, so deviations from the mean
    are multiplied by √(n / (n - 1)), for seeds as for parts. With one seed the interval is of these
    networks only. None with one part, or if every true value is 0.

    Args:
        error: squared errors [S,N] of S seeds, for all frames in time order, NaN for those that do
            not count; [S,N,R] for the interval of the mean over R columns.
        truth: [N] or [N,R], true values.
        drive: [N], the number of each frame's drive.
        other: squared errors of a second model, for the paired difference, narrower if both err on
            the same roads.
    """
    # Frames that count, and sums over them by part; zero is the error of always predicting zero.
    squares = (truth**2).reshape(1, len(truth), -1)  # [1,N,R]
    models = [error.reshape(*error.shape[:2], -1)]
    if other is not None:
        models.append(other.reshape(*other.shape[:2], -1))
    counted = np.isfinite(squares).all(axis=0)  # [N,R]
    for values in models:
        counted &= np.isfinite(values).all(axis=0)
    part = parts(drive, settings.bootstrap_block_frames)
    zero = sums_by_part(squares, counted, part)[0]  # [D,R]
    errors = [sums_by_part(values, counted, part) for values in models]  # each [S,D,R]

    bends = zero.any(axis=0)
    if len(zero) < 2 or not bends.any():
        return None
    zero = zero[:, bends]
    errors = [values[..., bends] for values in errors]

    # Errors of the first model, less those of the second, on drawn roads and with drawn seeds.
    rng = np.random.default_rng(settings.seed)
    samples = settings.bootstrap_samples
    drawn_parts = draw(len(zero), samples, rng)
    drawn = drawn_error(errors[0], drawn_parts, draw_seeds(len(errors[0]), samples, rng))
    mean = mean_nmse(errors[0], zero)
    if len(errors) > 1:
        drawn -= drawn_error(errors[1], drawn_parts, draw_seeds(len(errors[1]), samples, rng))
        mean -= mean_nmse(errors[1], zero)

    # The same relative to zero on the drawn roads; NaN where these are straight.
    drawn_zero = np.einsum("bd,dr->br", drawn_parts, zero)
    drawn_nmse = np.full_like(drawn, np.nan)
    np.divide(drawn, drawn_zero, out=drawn_nmse, where=drawn_zero > 0)
    percentiles = np.nanpercentile(drawn_nmse.mean(axis=1), [2.5, 97.5])
    low, high = (mean + widened(len(zero)) * (percentiles - mean)).tolist()
    if other is None:  # no error is below 0
        return [max(low, 0.0), max(high, 0.0)]
    return [low, high]


def sums_by_part(values: np.ndarray, counted: np.ndarray, part: np.ndarray) -> np.ndarray:
    """Return the sums [S,D,R] of values [S,N,R] over the frames of each part that has `counted`
    ones, bool [N,R].
    """
    rows = counted.any(axis=1)
    _, first = np.unique(part[rows], return_index=True)
    if not len(first):
        return np.zeros((len(values), 0, values.shape[-1]))
    return np.add.reduceat(np.where(counted, values, 0.0)[:, rows], first, axis=1)


def draw(count: int, samples: int, rng: np.random.Generator) -> np.ndarray:
    """Return how often each of `count` things is drawn with replacement, [samples,count]."""
    return rng.multinomial(count, np.full(count, 1 / count), samples)


def draw_seeds(count: int, samples: int, rng: np.random.Generator) -> np.ndarray:
    """Return the weight of each seed in a mean over drawn seeds, [samples,count], widened."""
    return 1 + widened(count) * (draw(count, samples, rng) - 1)


def widened(count: int) -> float:
    """Return the factor by which deviations of a mean over drawn things are too small."""
    return math.sqrt(count / max(count - 1, 1))


def drawn_error(errors: np.ndarray, drawn_parts: np.ndarray, seeds: np.ndarray) -> np.ndarray:
    """Return the error [B,R] of each draw, the mean over seeds weighted by [B,S], of errors [S,D,R]
    by part.
    """
    by_seed = np.einsum("bd,sdr->bsr", drawn_parts, errors)
    return np.einsum("bs,bsr->br", seeds, by_seed) / len(errors)


def mean_nmse(errors: np.ndarray, zero: np.ndarray) -> float:
    """Return the nmse of errors [S,D,R], the mean over seeds and columns, for those of zero
    [D,R].
    """
    return float((errors.mean(axis=0).sum(axis=0) / zero.sum(axis=0)).mean())


def parts(drive: np.ndarray, block_frames: int) -> np.ndarray:
    """Return the number [N] of the part of each frame, for the numbers [N] of the frames' drives.

    A drive of two or more blocks is cut into equal parts of at least one block, which count as
    drives.
    """
    lengths = []
    for frames in np.split(drive, np.flatnonzero(np.diff(drive)) + 1):
        blocks = max(len(frames) // block_frames, 1)
        lengths += [len(part) for part in np.array_split(frames, blocks)]
    return np.repeat(np.arange(len(lengths)), lengths)


def verdict(bounds: Sequence[float] | None, seeds: int, drives: int) -> str:
    """Return what the :func:`interval` of a paired difference shows about the first of two methods.

    `seeds`: of the model that has fewer; `drives`: the :func:`parts`.
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


def untrained(nmse: np.ndarray) -> list[int]:
    """Return which seeds failed to train, by the nmse [S] of each on its own training drives."""
    return np.flatnonzero((nmse > 0.9) | (nmse > 0.5) & (nmse > 2 * np.median(nmse))).tolist()


def nmse_text(value: float, seeds: Sequence[float], bounds: Sequence[float] | None) -> str:
    """Return an nmse as text, with the standard deviation over seeds and its :func:`interval`."""
    spread = f" ± {np.std(seeds, ddof=1):.3f}" if len(seeds) > 1 else ""
    return f"{value:.3f}{spread} ({interval_text(bounds)})"


def interval_text(bounds: Sequence[float] | None, form: str = ".3f") -> str:
    """Return the bounds of an :func:`interval` as text, the reason if it is None."""
    if bounds is None:
        return "too short for an interval"
    low, high = bounds
    return f"{low:{form}} to {high:{form}}"
