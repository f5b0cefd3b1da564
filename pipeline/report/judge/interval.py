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
