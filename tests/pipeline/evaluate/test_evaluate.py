"""Errors of predictions: counted frames, drives, baselines; values by hand and intervals."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from pipeline.base.errors import InputError
from pipeline.evaluate import statistics
from pipeline.evaluate.error_table import (
    Predictions,
    common_frames,
    compare_methods,
    error_table,
    frame_errors,
)
from pipeline.evaluate.own_metrics import METRICS, Metric
from pipeline.evaluate.predictions import (
    Case,
    prediction_table,
    read_odometry,
    turning_frames,
)
from pipeline.evaluate.settings import Evaluate
from pipeline.train.loss import Scale
from pipeline.train.quantities.angle import Target
from pipeline.train.quantity import Measure, load_quantity
from pipeline.train.targets import LabelledDrive
from tests import artefacts
from tests.small_model import entry, read_drives

NAMES = ["2026_01_03_drive_0001", "2026_01_03_drive_0002"]


def read(folder: Path, horizon: int = 0) -> list[LabelledDrive]:
    return read_drives(folder, NAMES, horizon=horizon)


def settings(block: int, samples: int) -> Evaluate:
    """Return settings with blocks of some frames at 10 Hz."""
    return Evaluate(bootstrap_block_s=block / 10, bootstrap_samples=samples, seed=0)


def parts(drive: np.ndarray, block: int) -> np.ndarray:
    """Return the parts of drives [N] at 10 Hz, with blocks of some frames."""
    return statistics.number_parts(drive, np.arange(len(drive)) / 10, block / 10)


@pytest.fixture
def folder(tmp_path) -> Path:
    artefacts.write_dataset(tmp_path, dict.fromkeys(NAMES, "test"), frames=30, points=40)
    return tmp_path


def case(drive: LabelledDrive, *seeds: np.ndarray, mean: float = 0.0) -> Case:
    scale = Scale(["steering_rad"], np.ones(1), np.zeros(1), np.ones(1), np.array([mean]))
    odometry = read_odometry(drive, entry(horizon=drive.quantity.horizon))
    return Case(drive, seeds, scale, odometry, odometry_gain=np.array([0.5]))


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


@pytest.mark.parametrize(
    ("measured", "baselines"),
    [
        (NAMES, ["zero", "train_mean", "odometry", "regression", "persistence"]),
        (NAMES[:1], ["zero", "train_mean", "odometry", "regression", "persistence"]),
        ([], ["zero", "train_mean", "persistence"]),
    ],
)
def test_odometry_is_0_in_drives_where_nothing_is_measured(folder, measured, baselines):
    """It counts there as before the first measurement, and no drive removes it from the others."""
    valid = np.arange(30) > 2
    cases = []
    for drive in read(folder):
        is_measured = valid & (drive.name in measured)
        artefacts.write_steered(drive.motion_file, drive.target[:, 0], is_measured)
        cases.append(case(drive, drive.target))
    predictions = common_frames(
        {"net": prediction_table("net", [0], cases)}, cases[0].drive.quantity
    )
    assert [*predictions.predicted] == ["net", *baselines]
    assert predictions.unmeasured == [name for name in NAMES if measured and name not in measured]
    for name, factor in {"odometry": 1.0, "regression": 0.5}.items():
        if measured:
            is_known = predictions.frames["drive"].isin(measured) & np.tile(valid, 2)
            expected = np.where(is_known, factor * predictions.truth[:, 0], 0)
            values = predictions.predicted[name][0, :, 0]
            np.testing.assert_allclose(values, expected, rtol=1e-4, atol=1e-9)


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


@pytest.mark.parametrize(
    ("name", "metric", "message"),
    [
        ("worst", Metric(lambda *_: np.nan, ("rad",)), "metric worst returned nan"),
        ("nmse", Metric(lambda *_: 0.5, ("rad",)), "metric nmse has the name of a column"),
        ("parameters", Metric(lambda *_: 0.5, ("rad",)), "metric parameters has the name of"),
        ("worst", lambda *_: 0.5, "metric worst does not name its units"),
        ("worst", Metric(lambda *_: 0.5, "rad"), "metric worst does not name its units"),
    ],
)
def test_a_metric_without_a_number_units_or_a_name_of_its_own_is_refused(
    monkeypatch, name, metric, message
):
    monkeypatch.setitem(METRICS, name, metric)
    with pytest.raises(InputError, match=message):
        by_hand(np.ones(3), np.ones(3))


def ahead(truth_1pm: np.ndarray, **predicted_1pm: np.ndarray) -> Predictions:
    """Return predictions [S,N,2] of a path [N,2] in 0 to 5 and 5 to 10 m, in drives of 2 frames."""
    quantity = load_quantity("path")({**artefacts.LABELS["labels"], "ahead_m": [0, 5, 10]})
    frame = np.arange(len(truth_1pm))
    drive = [f"drive {number // 2}" for number in frame]
    frames = pd.DataFrame({"drive": drive, "frame": frame, "time_s": 0.0, "speed_mps": 8.0})
    return Predictions(quantity, frames, truth_1pm, predicted_1pm)


def test_a_frame_counts_at_an_end_if_all_ranges_up_to_it_are_known():
    """The true path is straight. At 5 m, an arc of 0.2/m has turned by 1 rad."""
    truth = np.array([[0, 0], [0, np.nan], [np.nan, 0], [0, 0]])
    predicted = np.array([[0.2, 0.0], [0.2, 0.0], [0.2, 0.0], [0.0, 0.2]])
    predictions = ahead(truth, net=np.stack([predicted, 0 * predicted]))
    arc_m = np.hypot(5 * np.sin(1) - 5, 5 * (1 - np.cos(1)))
    straight_m = np.hypot(5 * np.sin(1) + 5 * np.cos(1) - 10, 5 * (1 - np.cos(1)) + 5 * np.sin(1))
    errors = frame_errors(predictions, "net")
    np.testing.assert_allclose(errors["at 5 m"].error[0, :, 0], [arc_m, arc_m, np.nan, 0])
    np.testing.assert_allclose(
        errors["at 10 m"].error[0, :, 0], [straight_m, np.nan, np.nan, arc_m]
    )
    np.testing.assert_allclose(errors["5-10 m"].error[0, :, 0], [0, np.nan, 0, 0.04])

    table = error_table(predictions, ["net"], settings(2, 50))
    near = table.loc[("at 5 m", "net")]
    far = table.loc[("at 10 m", "net")]
    assert [near["frames"], far["frames"]] == [3, 2]
    assert near["seeds"] == pytest.approx([2 * arc_m / 3, 0])
    assert [near["error"], far["error"]] == pytest.approx([arc_m / 3, (straight_m + arc_m) / 4])
    assert [near["worst_drive"], near["worst_share"]] == ["drive 0", 1]
    assert far["worst_share"] == pytest.approx(straight_m / (straight_m + arc_m))
    assert pd.isna(far["nmse"])
    assert pd.isna(table.loc[("5-10 m", "net"), "error"])


def test_a_pair_has_one_interval_and_only_the_error_that_leads_has_a_verdict():
    rng = np.random.default_rng(0)
    truth = rng.normal(0, 0.05, (40, 2))
    good = truth + rng.normal(0, 0.01, (2, 40, 2))
    bad = truth + rng.normal(0, 0.03, (3, 40, 2))
    zero = np.zeros((1, 40, 2))
    table = compare_methods(ahead(truth, net=good, a=bad, zero=zero), settings(2, 300))
    for label in ("at 5 m", "at 10 m", "", "0-5 m", "5-10 m"):
        one = table.loc[(label, "net - a")]
        other = table.loc[(label, "a - net")]
        value = "error" if label.startswith("at") else "nmse"
        assert one[value] == -other[value]
        assert [one["low"], one["high"]] == [-other["high"], -other["low"]]
        assert one["low"] < one[value] < one["high"]
        assert not np.isnan(table.loc[(label, "net - zero"), "low"])
    verdicts = table["verdict"].dropna()
    assert verdicts.to_dict() == {
        ("at 5 m", "a - net"): "worse",
        ("at 5 m", "net - a"): "better",
        ("at 5 m", "net - zero"): "better",
        ("at 5 m", "a - zero"): "better",
    }


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.003, "0.003"), (0.0004, "0.0004"), (1.234, "1.23"), (0, "0.00"), (1e-9, "0.00")],
)
def test_a_small_error_is_not_printed_as_0(value, text):
    assert statistics.number_text(value, Measure("displacement", "m", 2, "")) == text


@pytest.mark.parametrize(
    ("bounds", "digits", "verdict"),
    [
        ((-0.3, -0.006), 2, "better"),
        ((-0.3, -0.004), 2, "no difference shown"),
        ((-0.3, -0.004), 3, "better"),
        ((0.004, 0.3), 2, "no difference shown"),
        ((0.006, 0.3), 2, "worse"),
        (None, 2, "no difference shown"),
    ],
)
def test_a_bound_that_is_printed_as_0_excludes_nothing(bounds, digits, verdict):
    assert statistics.judge_difference(bounds, 2, 10, digits) == verdict
    assert statistics.bounds_text({"low": -0.004, "high": 0.3}, "+z.2f") == "0.00 to +0.30"


@pytest.mark.parametrize("source", ["oxts", "visual"])
def test_odometry_needs_measured_frames_and_other_labels(folder, monkeypatch, source):
    """At horizon 0, labels from visual odometry are not compared with it."""
    monkeypatch.setitem(artefacts.MEASURED, "measured", int(source == "visual"))
    artefacts.write_dataset(folder, dict.fromkeys(NAMES, "test"), frames=30, points=40)
    without = ["train_mean", "persistence"]
    measured = ["odometry", "regression"]

    def baselines(horizon: int, number: int = 0) -> dict[str, np.ndarray]:
        drive = read(folder, horizon)[number]
        return case(drive, np.zeros((30, 1)), mean=0.05).predict_baselines()

    first, _ = read(folder)  # nothing is measured in the second drive
    valid = np.arange(30) > 2
    artefacts.write_steered(first.motion_file, first.target[:, 0], valid)
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


def test_a_quantity_without_a_path_has_no_number_of_turning_frames(folder, monkeypatch):
    drives = read(folder)
    turns = np.concatenate([np.abs(drive.target) > 0.02 for drive in drives])
    assert turning_frames(drives) == turns.sum() > 0
    monkeypatch.setattr(Target, "curvature", lambda self, values: np.full_like(values, np.nan))
    assert turning_frames(drives) is None


@pytest.mark.parametrize(
    ("nmse", "mean_nmse", "untrained"),
    [
        ([0.1, 0.2, 0.6], 1.0, [2]),
        ([0.3, 0.4, 0.6], 1.0, []),
        ([0.95, 0.1], 1.1, [0]),
        ([0.95], 1.0, [0]),
        ([np.nan, 0.1], 1.0, []),
        ([0.095, 0.02], 0.1, [0]),  # of a speed, whose mean is far from zero
    ],
)
def test_seeds_that_did_not_train(nmse, mean_nmse, untrained):
    assert statistics.find_untrained(np.array(nmse), mean_nmse) == untrained


def interval(
    steering: np.ndarray,
    error: np.ndarray,
    drive: np.ndarray,
    block: int,
    samples: int,
    other: np.ndarray | None = None,
) -> list[float] | None:
    """Return the interval of the nmse for errors [N] or [S,N] in rad."""
    first = squared_errors(np.atleast_2d(error) ** 2, steering)
    second = None if other is None else squared_errors(np.atleast_2d(other) ** 2, steering)
    part = parts(drive, block)
    return statistics.bootstrap_interval(first, part, settings(block, samples), second)


def squared_errors(square: np.ndarray, truth: np.ndarray) -> statistics.FrameErrors:
    """Return squared errors [S,N] or [S,N,C] of true values [N] or [N,C], for their nmse."""
    count = len(truth)
    square = square.reshape(len(square), count, -1)
    return statistics.count_frames(square, truth.reshape(count, -1) ** 2)


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
        first = squared_errors(squared_error(true, 0.146), true)
        second = squared_errors(squared_error(true, 0.124), true)
        part = parts(drive, 100)
        low, high = statistics.bootstrap_interval(first, part, settings(100, 300), second)
        errors.append(1.96 * (low + high - 2 * (0.146 - 0.124)) / (high - low))
    # Over 12 seeds: 0.97 ± 0.07 for twenty drives, 1.02 ± 0.04 for one.
    assert 0.7 < np.std(errors) < 1.3


def test_drives_of_two_or_more_blocks_are_cut_into_equal_parts():
    part = parts(np.repeat([4, 7, 2, 3], [5, 9, 10, 27]), 5)
    assert np.bincount(part).tolist() == [5, 9, 5, 5, 6, 6, 5, 5, 5]


@pytest.mark.parametrize("rate", [5, 10, 29.97, 30])
@pytest.mark.parametrize(("length_s", "gap_s", "count"), [(70, 0, 3), (200, 0, 10), (70, 3600, 3)])
def test_parts_of_drives_are_as_long_in_seconds_at_each_rate(rate, length_s, gap_s, count):
    """A gap in the middle of a drive does not count. Times have an offset and are rounded."""
    time_s = np.round(1000 + np.arange(np.ceil(length_s * rate)) / rate, 3)
    time_s[len(time_s) // 2 :] += gap_s
    part = statistics.number_parts(np.zeros(len(time_s)), time_s, 20.0)
    assert part.max() + 1 == count


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
    truth = np.stack([steering] * 3, axis=-1)
    errors = squared_errors(first[..., None] ** 2 * columns, truth)
    others = squared_errors(second[..., None] ** 2 * columns, truth)
    part = parts(drive, 50)
    paired = statistics.bootstrap_interval(errors, part, settings(50, 500), others)
    assert paired == pytest.approx([2 * low, 2 * high])
