import numpy as np
import pytest

from pipeline.report import judge as metrics


def test_scores_by_hand() -> None:
    result = metrics.scores(np.array([0.1, -0.1, 0.2]), np.array([0.1, 0.1, 0.1]))
    assert result["frames"] == 3
    assert result["mse_rad2"] == pytest.approx((0 + 0.04 + 0.01) / 3)
    assert result["nmse"] == pytest.approx(0.05 / 0.06)
    assert result["mae_deg"] == pytest.approx(np.rad2deg(0.1))
    assert result["rmse_deg"] == pytest.approx(np.rad2deg(np.sqrt(0.05 / 3)))


def test_zero_prediction_has_nmse_one_and_a_degenerate_interval() -> None:
    steering = np.sin(np.arange(300) / 20)
    low, high = metrics.nmse_interval(steering, np.zeros(300), np.zeros(300), 50, 200, seed=0)
    assert metrics.scores(steering, np.zeros(300))["nmse"] == low == high == 1.0


def test_interval_covers_the_truth_about_as_often_as_it_says() -> None:
    """Errors with 10-frame memory: blocks must give an interval that holds the true ratio in most repetitions."""
    hits = 0
    for seed in range(60):
        rng = np.random.default_rng(seed)
        noise = np.convolve(rng.normal(size=620), np.ones(10) / np.sqrt(10), "valid")[:600]
        steering = np.convolve(rng.normal(size=620), np.ones(10) / np.sqrt(10), "valid")[:600]
        low, high = metrics.nmse_interval(steering, steering + 0.5 * noise, np.zeros(600), 50, 400, seed=0)
        hits += low <= 0.25 <= high
    assert 48 <= hits <= 60


def test_scores_of_seeds_are_means_and_the_interval_is_that_of_the_mean_error() -> None:
    rng = np.random.default_rng(0)
    steering, drive = rng.normal(size=400), np.repeat([0, 1], 200)
    seeds = steering + rng.normal(size=(3, 400)) * np.array([[0.3], [0.5], [0.7]])
    alone = [metrics.scores(steering, of_seed) for of_seed in seeds]
    both = metrics.scores(steering, seeds)
    assert both["frames"] == 400
    for key in ("mse_rad2", "nmse", "mae_deg"):
        assert both[key] == pytest.approx(np.mean([scores[key] for scores in alone]))
    assert metrics.nmse_std(steering, seeds) == pytest.approx(np.std([scores["nmse"] for scores in alone], ddof=1))
    assert metrics.nmse_std(steering, seeds[:1]) is None
    # An error whose square is the seeds' mean square, frame by frame, has the same interval.
    typical = steering + np.sqrt(((seeds - steering) ** 2).mean(axis=0))
    assert metrics.nmse_interval(steering, seeds, drive, 50, 300, 0) == pytest.approx(
        metrics.nmse_interval(steering, typical, drive, 50, 300, 0)
    )


def test_interval_draws_blocks_within_drives_only() -> None:
    steering = np.concatenate([np.full(20, 0.1), np.full(20, 0.3)])
    predicted = np.concatenate([np.zeros(20), np.full(20, 0.3)])
    drive = np.repeat([0, 1], 20)
    low, high = metrics.nmse_interval(steering, predicted, drive, block=20, samples=500, seed=0)
    # Two blocks are drawn, each a whole drive: error ratios 1, 0.1 (one of each) and 0.
    assert (low, high) == (0.0, 1.0)
    assert metrics.nmse_interval(steering, predicted, drive, block=500, samples=500, seed=0) == (low, high)


def test_bins_show_what_driving_straight_on_would_score() -> None:
    steering, curvature = np.array([0.0, 0.01, 0.2, -0.3]), np.array([0.0, 0.001, 0.07, -0.1])
    straight, slight, sharp = metrics.by_curvature(steering, np.full(4, 0.01), curvature, [0.005, 0.03])
    assert [row["frames"] for row in (straight, slight, sharp)] == [2, 0, 2]
    assert "zero" not in slight
    assert sharp["zero"]["mse_rad2"] == pytest.approx((0.04 + 0.09) / 2)
    assert straight["mse_rad2"] == pytest.approx(0.0001 / 2)


def test_a_short_drive_does_not_shorten_the_blocks_of_a_long_one() -> None:
    rng = np.random.default_rng(0)
    error = np.repeat(rng.normal(size=30), 20)  # errs alike for 20 frames
    steering = np.ones(600)
    alone = metrics.nmse_interval(steering, 1 + error, np.zeros(600), 100, 2000, seed=0)
    drive = np.concatenate([np.zeros(600), np.ones(2)])
    joined = metrics.nmse_interval(np.ones(602), np.append(1 + error, [1, 1]), drive, 100, 2000, seed=0)
    assert joined == pytest.approx(alone, rel=0.1)


def test_labels_that_are_all_zero_have_no_nmse() -> None:
    assert metrics.scores(np.zeros(3), np.ones(3))["nmse"] is None


def test_persistence_uses_the_last_valid_frame_before() -> None:
    steering = np.array([0.1, 0.2, 0.3, 0.4])
    valid = np.array([True, False, True, True])
    assert metrics.last_valid(steering, valid) == pytest.approx([np.nan, 0.1, 0.1, 0.3], nan_ok=True)
    assert len(metrics.last_valid(np.empty(0), np.empty(0, bool))) == 0


def test_baselines_by_hand() -> None:
    steering = np.array([0.1, 0.2])
    result = metrics.baselines(steering, np.array([np.nan, 0.1]), train_mean_rad=0.1)
    assert result["zero"]["nmse"] == 1.0
    assert result["train_mean"]["mse_rad2"] == pytest.approx(0.005)
    assert result["persistence"]["mse_rad2"] == pytest.approx((0.01 + 0.01) / 2)


def test_curvature_bins_split_the_frames() -> None:
    curvature = np.array([0.0, -0.004, 0.01, -0.02, 0.1])
    rows = metrics.by_curvature(np.full(5, 0.1), np.zeros(5), curvature, [0.005, 0.03])
    assert [row["frames"] for row in rows] == [2, 2, 1]
    assert rows[-1]["to_1pm"] is None
    empty = metrics.by_curvature(np.full(2, 0.1), np.zeros(2), np.zeros(2), [0.005])
    assert empty[1] == {"from_1pm": 0.005, "to_1pm": None, "frames": 0}
