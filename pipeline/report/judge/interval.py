"""Estimate the uncertainty of an nmse: over roads (moving-block bootstrap) and over seeds."""

import numpy as np

from pipeline.train import score

_DRAWS_AT_ONCE = 1 << 22  # bounds the memory of the bootstrap at about 100 MB


def nmse_std(steering_rad: np.ndarray, predicted_rad: np.ndarray) -> float | None:
    """Return the standard deviation of nmse over the seeds of predictions [S,N]; None for one seed."""
    nmse = [score.nmse(steering_rad, one_seed) for one_seed in predicted_rad]
    return float(np.std(nmse, ddof=1)) if len(nmse) > 1 and not np.isnan(nmse).any() else None


def nmse_interval(
    steering_rad: np.ndarray, predicted_rad: np.ndarray, drive: np.ndarray, block: int, samples: int, seed: int
) -> tuple[float, float]:
    """Return the 95 % interval of nmse from a moving-block bootstrap.

    Errors of neighbouring frames are correlated, so blocks of `block` consecutive rows are drawn, each within a drive.

    Args:
        steering_rad: [N] in time order.
        predicted_rad: [N], or [S,N] for S seeds, whose squared errors are averaged per frame: the interval of their
            mean nmse on other roads, given these networks.
        drive: [N], the number of each row's drive.
        block: rows per block; a shorter drive is one block.
        samples: bootstrap samples.
        seed: of the draws.
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
    """Return the 95 % interval of nmse(predicted_rad) - nmse(other_rad), both on the same blocks of the same frames.

    It is narrower than the interval of either nmse if both models have their errors on the same roads. Predictions
    [S,N] and [S',N]; the other arguments as in :func:`nmse_interval`.
    """
    error, other = (np.atleast_2d((angles - steering_rad) ** 2).mean(axis=0) for angles in (predicted_rad, other_rad))
    return _interval(error - other, steering_rad**2, drive, block, samples, seed)


def _interval(
    error: np.ndarray, zero: np.ndarray, drive: np.ndarray, block: int, samples: int, seed: int
) -> tuple[float, float]:
    """Return the 95 % interval of Σ error / Σ zero over blocks of the rows [N]."""
    first = np.flatnonzero(np.diff(drive, prepend=drive[0] - 1))  # [D] first row of each drive
    length = np.minimum(block, np.diff(first, append=len(drive)))
    last = np.append(first[1:], len(drive)) - length  # [D] last row at which a block can start
    starts = np.concatenate([np.arange(a, b + 1) for a, b in zip(first, last, strict=True)])
    length = np.repeat(length, last - first + 1)
    sums = np.concatenate([np.zeros((2, 1)), np.cumsum(np.stack([error, zero]), axis=1)], axis=1)
    block_sums = sums[:, starts + length] - sums[:, starts]  # [2, blocks]
    count = int(np.ceil(len(drive) / length.mean()))
    rng, step = np.random.default_rng(seed), max(1, _DRAWS_AT_ONCE // count)
    ratios = []
    for done in range(0, samples, step):
        draws = rng.integers(len(starts), size=(min(step, samples - done), count))
        errors, zeros = block_sums[:, draws].sum(axis=2)
        with np.errstate(divide="ignore", invalid="ignore"):
            ratios.append(np.where(zeros > 0, errors / zeros, np.nan))
    low, high = np.nanpercentile(np.concatenate(ratios), [2.5, 97.5])
    return float(low), float(high)
