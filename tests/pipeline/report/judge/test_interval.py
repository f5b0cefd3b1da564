import numpy as np
import pytest

from pipeline.report.judge import errors, interval


def test_zero_prediction_has_nmse_one_and_a_degenerate_interval() -> None:
    steering = np.sin(np.arange(300) / 20)
    low, high = interval.nmse_interval(steering, np.zeros(300), np.zeros(300), 50, 200, seed=0)
    assert errors.scores(steering, np.zeros(300))["nmse"] == low == high == 1.0


def test_interval_has_its_coverage() -> None:
    """Errors are correlated over 10 frames; the interval contains the true ratio in most repetitions."""
    hits = 0
    for seed in range(30):
        rng = np.random.default_rng(seed)
        noise = np.convolve(rng.normal(size=620), np.ones(10) / np.sqrt(10), "valid")[:600]
        steering = np.convolve(rng.normal(size=620), np.ones(10) / np.sqrt(10), "valid")[:600]
        low, high = interval.nmse_interval(steering, steering + 0.5 * noise, np.zeros(600), 50, 400, seed=0)
        hits += low <= 0.25 <= high
    assert 24 <= hits <= 30


def test_scores_over_seeds_are_means() -> None:
    rng = np.random.default_rng(0)
    steering, drive = rng.normal(size=400), np.repeat([0, 1], 200)
    seeds = steering + rng.normal(size=(3, 400)) * np.array([[0.3], [0.5], [0.7]])
    alone = [errors.scores(steering, one_seed) for one_seed in seeds]
    both = errors.scores(steering, seeds)
    assert both["frames"] == 400
    for key in ("mse_rad2", "nmse", "mae_deg"):
        assert both[key] == pytest.approx(np.mean([scores[key] for scores in alone]))
    assert interval.nmse_std(steering, seeds) == pytest.approx(np.std([scores["nmse"] for scores in alone], ddof=1))
    assert interval.nmse_std(steering, seeds[:1]) is None
    # An error whose square is the seeds' mean square, frame by frame, has the same interval.
    typical = steering + np.sqrt(((seeds - steering) ** 2).mean(axis=0))
    assert interval.nmse_interval(steering, seeds, drive, 50, 300, 0) == pytest.approx(
        interval.nmse_interval(steering, typical, drive, 50, 300, 0)
    )


def test_interval_draws_blocks_within_drives_only() -> None:
    steering = np.concatenate([np.full(20, 0.1), np.full(20, 0.3)])
    predicted = np.concatenate([np.zeros(20), np.full(20, 0.3)])
    drive = np.repeat([0, 1], 20)
    low, high = interval.nmse_interval(steering, predicted, drive, block=20, samples=500, seed=0)
    # Two blocks are drawn, each a whole drive: error ratios 1, 0.1 (one of each) and 0.
    assert (low, high) == (0.0, 1.0)
    assert interval.nmse_interval(steering, predicted, drive, block=500, samples=500, seed=0) == (low, high)


def test_the_difference_of_two_models_has_a_narrower_interval() -> None:
    rng = np.random.default_rng(0)
    steering, drive = np.sin(np.arange(600) / 30), np.repeat([0, 1], 300)
    hard = np.repeat(rng.uniform(0, 1, 12), 50)  # both err on the same roads
    one, other = (steering + (hard * rng.normal(size=(2, 600)) * size) for size in (0.5, 0.55))
    low, high = interval.difference_interval(steering, one, other, drive, 50, 500, 0)
    alone = interval.nmse_interval(steering, one, drive, 50, 500, 0)
    assert high - low < 0.5 * (alone[1] - alone[0])
    assert interval.difference_interval(steering, one, one, drive, 50, 100, 0) == (0.0, 0.0)
