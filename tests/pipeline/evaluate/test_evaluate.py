"""Errors of predictions: counted frames, drives, baselines; values by hand and intervals."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from pipeline.base.errors import InputError
from pipeline.evaluate import statistics
from pipeline.evaluate.error_table import Predictions, common_frames, error_table
from pipeline.evaluate.own_metrics import METRICS
from pipeline.evaluate.predictions import Case, prediction_table
from pipeline.evaluate.settings import Evaluate
from pipeline.train.loss import Scale
from pipeline.train.quantity import load_quantity
from pipeline.train.targets import LabelledDrive
from tests import artefacts
from tests.small_model import read_drives

NAMES = ["2026_01_03_drive_0001", "2026_01_03_drive_0002"]


def read(folder: Path, horizon: int = 0) -> list[LabelledDrive]:
    return read_drives(folder, NAMES, horizon=horizon)


def settings(block: int, samples: int) -> Evaluate:
    return Evaluate(bootstrap_block_frames=block, bootstrap_samples=samples, seed=0)


@pytest.fixture
def folder(tmp_path) -> Path:
    artefacts.write_dataset(tmp_path, dict.fromkeys(NAMES, "test"), frames=30, points=40)
    return tmp_path


def case(drive: LabelledDrive, *seeds: np.ndarray, mean: float = 0.0) -> Case:
    gain = None if drive.odometry is None else np.array([0.5])
    scale = Scale(["steering_rad"], np.ones(1), np.ones(1), np.array([mean]), gain)
    return Case(drive, seeds, scale)


def test_invalid_and_early_frames_do_not_count(folder):
    test = read(folder)
    cases = []
    for drive in test:
        predicted = drive.target + 0.01
        predicted[:3] = np.nan
        cases.append(case(drive, predicted))
    test[0].target[10:15] = np.nan
    predictions = common_frames({"net": prediction_table("net", [0], cases)}, test[0].quantity)
    row = error_table(predictions, ["net"], settings(block=5, samples=100)).loc[("", "net")]
    assert row["frames"] == 2 * (30 - 3) - 5
    assert row["drives"] == 2
    assert row["mse"] == pytest.approx(0.01**2)
    assert row["low"] <= row["nmse"] <= row["high"]


def by_hand(truth: np.ndarray, predicted: np.ndarray) -> pd.Series:
    """Return the errors of predictions [N] for the steering angles [N] of a drive."""
    quantity = load_quantity("angle")(artefacts.LABELS["labels"])
    frame = np.arange(len(truth))
    frames = pd.DataFrame({"drive": "a", "frame": frame, "time_s": frame / 10, "speed_mps": 8.0})
    predictions = Predictions(quantity, frames, truth[:, None], {"net": predicted[None, :, None]})
    return error_table(predictions, ["net"], settings(50, 200)).loc[("", "net")]


def test_errors_by_hand():
    row = by_hand(np.array([0.1, -0.1, 0.2]), np.array([0.1, 0.1, 0.1]))
    assert row["frames"] == 3
    assert row["mse"] == pytest.approx((0 + 0.04 + 0.01) / 3)
    assert row["nmse"] == pytest.approx(0.05 / 0.06)
    assert row["mae"] == pytest.approx(np.rad2deg(0.1))
    assert by_hand(np.zeros(3), np.ones(3))["nmse"] is None
    steering = np.sin(np.arange(300) / 20)
    row = by_hand(steering, 0 * steering)
    assert [row["nmse"], row["low"], row["high"]] == [1.0, 1.0, 1.0]


def test_a_metric_that_returns_no_number_is_named(monkeypatch):
    monkeypatch.setitem(METRICS, "worst", lambda *_: float("nan"))
    with pytest.raises(InputError, match="metric worst returned nan"):
        by_hand(np.ones(3), np.ones(3))


@pytest.mark.parametrize("source", ["oxts", "visual"])
def test_odometry_needs_motion_in_all_frames_and_other_labels(folder, monkeypatch, source):
    """At horizon 0, labels from visual odometry are not compared with it."""
    monkeypatch.setitem(artefacts.MEASURED, "measured", int(source == "visual"))
    artefacts.write_dataset(folder, dict.fromkeys(NAMES, "test"), frames=30, points=40)
    without = ["train_mean", "persistence"]
    measured = ["odometry", "regression"]

    def baselines(horizon: int, number: int = 0) -> dict[str, np.ndarray]:
        drive = read(folder, horizon)[number]
        return case(drive, np.zeros((30, 1)), mean=0.05).predict_baselines()

    assert list(baselines(5)) == without
    first, second = read(folder)
    valid = np.arange(30) > 2
    artefacts.add_motion(first.graphs, first.target[:, 0], valid)
    artefacts.add_motion(second.graphs, second.target[:, 0], np.zeros(30, bool))
    values = baselines(5)
    assert list(values) == [*without, *measured]
    odometry = np.where(valid[:, None], first.target, np.nan)
    regression = np.where(valid[:, None], 0.5 * first.target, 0)
    np.testing.assert_allclose(values["odometry"], odometry, rtol=1e-4, atol=1e-9)
    np.testing.assert_allclose(values["regression"], regression, rtol=1e-4, atol=1e-9)
    assert (values["train_mean"] == 0.05).all()
    np.testing.assert_allclose(values["persistence"], first.target)
    assert all(np.isnan(baselines(5, 1)[name]).all() for name in measured)
    present = measured if source == "oxts" else []
    assert list(baselines(0)) == [*without, *present]
    # At horizon 0, the frame's own truth is the target.
    np.testing.assert_allclose(baselines(0)["persistence"], np.r_[[[0]], first.target[:-1]])


@pytest.mark.parametrize(
    ("nmse", "untrained"),
    [
        ([0.1, 0.2, 0.6], [2]),
        ([0.3, 0.4, 0.6], []),
        ([0.95, 0.1], [0]),
        ([0.95], [0]),
        ([np.nan, 0.1], []),
    ],
)
def test_seeds_that_did_not_train(nmse, untrained):
    assert statistics.find_untrained(np.array(nmse)) == untrained


def interval(
    steering: np.ndarray,
    error: np.ndarray,
    drive: np.ndarray,
    block: int,
    samples: int,
    other: np.ndarray | None = None,
) -> list[float] | None:
    """Return the interval for errors [N] or [S,N] in rad."""
    squared = np.atleast_2d(error) ** 2
    rival = None if other is None else np.atleast_2d(other) ** 2
    return statistics.bootstrap_interval(squared, steering, drive, settings(block, samples), rival)


@pytest.mark.parametrize(("drives", "frames"), [(20, 30), (1, 3000)])
def test_intervals_of_paired_differences_are_as_wide_as_the_errors(drives, frames):
    """Twenty drives, or a long one that is cut into parts.

    Errors of two models vary by seed, road and both.
    """
    rng = np.random.default_rng(0)
    drive = np.repeat(np.arange(drives), frames)
    road = np.arange(len(drive)) // min(frames, 100)

    def squared_error(true: np.ndarray, nmse: float) -> np.ndarray:
        """Draw errors [5,N] of five seeds, with a mean nmse."""
        spread = np.zeros((5, 30))
        for sigma, shape in ((0.3, (5, 1)), (0.5, (1, 30)), (0.5, (5, 30))):
            spread = spread + rng.normal(-(sigma**2) / 2, sigma, shape)
        return nmse * true**2 * np.exp(spread)[:, road]

    errors = []  # in standard deviations, of which an interval has 1.96 on each side
    for _ in range(180):
        true = rng.normal(size=len(drive))
        first = squared_error(true, 0.146)
        second = squared_error(true, 0.124)
        low, high = statistics.bootstrap_interval(first, true, drive, settings(100, 300), second)
        errors.append(1.96 * (low + high - 2 * (0.146 - 0.124)) / (high - low))
    # Over 12 seeds: 0.97 ± 0.07 for twenty drives, 1.02 ± 0.04 for one.
    assert 0.7 < np.std(errors) < 1.3


def test_drives_of_two_or_more_blocks_are_cut_into_equal_parts():
    part = statistics.number_parts(np.repeat([4, 7, 2, 3], [5, 9, 10, 27]), 5)
    assert np.bincount(part).tolist() == [5, 9, 5, 5, 6, 6, 5, 5, 5]


def test_interval_draws_parts_and_widens_their_deviation():
    steering = np.concatenate([np.full(20, 0.1), np.full(20, 0.3)])
    error = np.concatenate([np.full(20, 0.1), np.zeros(20)])
    # Two drives are drawn, each complete: error ratios 1, 0.1 (one of each) and 0. No nmse is below
    # 0.
    bounds = [0, pytest.approx(0.1 + np.sqrt(2) * 0.9)]
    assert interval(steering, error, np.repeat([0, 1], 20), block=20, samples=500) == bounds
    assert interval(steering, error, np.zeros(40), block=20, samples=500) == bounds

    # A difference may be below 0.
    difference = interval(steering, 0 * error, np.zeros(40), 20, 500, error)
    assert difference == pytest.approx([-0.1 - np.sqrt(2) * 0.9, -0.1 + np.sqrt(2) * 0.1])


def test_seeds_of_each_model_are_drawn_independently_of_the_other_model():
    """All roads are equal, so that the interval is that of the mean over seeds.

    Its deviation is that for n - 1.
    """
    steering = np.full(60, 0.1)
    drive = np.arange(60) // 3
    nmse = [4, 5, 6, 7, 9, 10, 12, 13, 15, 19]
    error = 0.1 * np.sqrt(nmse)[:, None] * np.ones(60)

    reach = 1.96 * np.std(nmse, ddof=1) / np.sqrt(10)
    bounds = interval(steering, error, drive, 50, 20_000)
    assert bounds == pytest.approx([10 - reach, 10 + reach], rel=0.05)
    difference = interval(steering, error, drive, 50, 20_000, error)
    assert difference == pytest.approx([-reach * np.sqrt(2), reach * np.sqrt(2)], rel=0.05)
    assert interval(steering, error[:1], drive, 50, 500) == pytest.approx([4, 4])


def test_frames_that_do_not_count_keep_their_place_in_time():
    """One frame in 20 counts, two in each of 20 parts; 40 frames alone would be one part."""
    steering = np.full(800, 0.1)
    error = np.full(800, np.nan)
    error[::20] = 0.1
    assert interval(steering, error, np.zeros(800), block=40, samples=200) == pytest.approx([1, 1])
    rows = np.isfinite(error)
    assert interval(steering[rows], error[rows], np.zeros(40), block=40, samples=200) is None
    assert interval(0 * steering, error, np.zeros(800), block=40, samples=9) is None


def test_the_difference_of_two_models_has_a_narrower_interval():
    rng = np.random.default_rng(0)
    steering = np.sin(np.arange(600) / 30)
    drive = np.repeat([0, 1], 300)
    hard = np.repeat(rng.uniform(0, 1, 12), 50)  # both err on the same roads
    noise = rng.normal(size=(2, 600))
    first = (0.5 * hard * noise)[:1]
    second = (0.55 * hard * noise)[:1]

    low, high = interval(steering, first, drive, 50, 500, second)
    alone = interval(steering, first, drive, 50, 500)
    assert high - low < 0.5 * (alone[1] - alone[0])

    # Three columns are drawn together.
    columns = np.array([1, 2, 3])
    errors = first[..., None] ** 2 * columns
    others = second[..., None] ** 2 * columns
    truth = np.stack([steering] * 3, axis=-1)
    paired = statistics.bootstrap_interval(errors, truth, drive, settings(50, 500), others)
    assert paired == pytest.approx([2 * low, 2 * high])
