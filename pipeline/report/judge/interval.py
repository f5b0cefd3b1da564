"""How sure one can be of an nmse: between roads, and between seeds."""

import numpy as np

from pipeline.train import score


def nmse_std(steering_rad: np.ndarray, predicted_rad: np.ndarray) -> float | None:
    """Return the standard deviation of nmse over seeds, from predictions [S,N]; None of one seed."""
    of_seeds = [score.nmse(steering_rad, of_seed) for of_seed in predicted_rad]
    return float(np.std(of_seeds, ddof=1)) if len(of_seeds) > 1 and not np.isnan(of_seeds).any() else None


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
    error = np.atleast_2d((predicted_rad - steering_rad) ** 2).mean(axis=0)
    return _interval(error, steering_rad**2, drive, block, samples, seed)


def difference_interval(
    steering_rad: np.ndarray,
    predicted_rad: np.ndarray,
    other_rad: np.ndarray,
    drive: np.ndarray,
    block: int,
    samples: int,
    seed: int,
) -> tuple[float, float]:
    """Return the 95 % interval of one model's nmse minus another's, both on the same blocks of the same frames.

    Much narrower than either's own interval where they find the same roads hard. Predictions [S,N] and [S',N];
    everything else as in :func:`nmse_interval`.
    """
    error, other = (np.atleast_2d((angles - steering_rad) ** 2).mean(axis=0) for angles in (predicted_rad, other_rad))
    return _interval(error - other, steering_rad**2, drive, block, samples, seed)


def _interval(
    error: np.ndarray, zero: np.ndarray, drive: np.ndarray, block: int, samples: int, seed: int
) -> tuple[float, float]:
    """Return the 95 % interval of Σ error / Σ zero over blocks of the rows [N]."""
    first = np.flatnonzero(np.diff(drive, prepend=drive[0] - 1))  # [D] where drives begin
    length = np.minimum(block, np.diff(first, append=len(drive)))  # a drive shorter than a block is one
    last = np.append(first[1:], len(drive)) - length  # [D] the last start of a block
    starts = np.concatenate([np.arange(a, b + 1) for a, b in zip(first, last, strict=True)])
    length = np.repeat(length, last - first + 1)
    squared = np.stack([error, zero])  # [2,N]
    sums = np.concatenate([np.zeros((2, 1)), np.cumsum(squared, axis=1)], axis=1)
    of_block = sums[:, starts + length] - sums[:, starts]  # [2,S]
    count = int(np.ceil(len(drive) / length.mean()))
    draws = np.random.default_rng(seed).integers(len(starts), size=(samples, count))
    errors, zeros = of_block[:, draws].sum(axis=2)  # [samples] each
    with np.errstate(divide="ignore", invalid="ignore"):
        low, high = np.nanpercentile(np.where(zeros > 0, errors / zeros, np.nan), [2.5, 97.5])
    return float(low), float(high)
