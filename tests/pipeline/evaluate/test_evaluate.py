"""Metrics of a split: counted frames, drives, baselines; errors and their intervals; onsets of
turns and drift.
"""

import tarfile
from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from pipeline.base.errors import InputError
from pipeline.evaluate import statistics, turns
from pipeline.evaluate.cases import Case, metrics
from pipeline.evaluate.settings import Evaluate
from pipeline.evaluate.turns import drift, segments
from pipeline.ingest import packets
from pipeline.ingest.datasets.kitti import KittiDrive
from pipeline.labels import label
from pipeline.train.loss import Scale
from pipeline.train.targets import LabelledDrive, read_drive
from tests import artefacts
from tests.small_model import entry

NAMES = ["2026_01_03_drive_0001", "2026_01_03_drive_0002"]


def read(folder: Path, horizon: int = 0) -> list[LabelledDrive]:
    return [
        read_drive(folder / "graphs/semantic", folder / "labels", name, entry(horizon=horizon))
        for name in NAMES
    ]


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
    predicted = [drive.target + 0.01 for drive in test]
    for angles in predicted:
        angles[:3] = np.nan
    test[0].target[10:15], predicted[0][10:15] = np.nan, 99.0
    cases = [case(drive, angles) for drive, angles in zip(test, predicted, strict=True)]
    found = metrics(cases, settings(block=5, samples=100))["steering_rad"]
    assert found["frames"] == 2 * (30 - 3) - 5
    assert found["mse"] == pytest.approx(0.01**2)
    assert found["nmse_ci95"][0] <= found["nmse"] <= found["nmse_ci95"][1]
    assert found["nmse_by_seed"] == [found["nmse"]]


def test_a_metric_that_returns_no_number_is_named(monkeypatch):
    monkeypatch.setitem(
        statistics.METRICS, "worst", statistics.Metric(lambda truth, predicted: float("nan"))
    )
    with pytest.raises(InputError, match="metric worst returned nan"):
        statistics.scores(np.ones(3), np.ones(3))


@pytest.mark.parametrize("source", ["oxts", "visual"])
def test_odometry_needs_motion_in_all_frames_and_other_labels(folder, monkeypatch, source):
    """At horizon 0, labels from visual odometry are not compared with it."""
    monkeypatch.setitem(artefacts.MEASURED, "measured", int(source == "visual"))
    without = ["train_mean", "persistence"]

    def baselines(horizon: int) -> dict[str, np.ndarray]:
        return case(read(folder, horizon)[0], np.zeros((30, 1)), mean=0.05).baselines()

    assert list(baselines(5)) == without
    first = read(folder)[0]
    for valid, known in ((False, np.nan), (True, 1.0)):
        artefacts.write_dataset(folder, dict.fromkeys(NAMES, "test"), frames=30, points=40)
        artefacts.add_motion(first.graphs, first.target[:, 0], np.full(30, valid))
        found = baselines(5)
        assert list(found) == [*without, "odometry", "regression"]
        for name, gain in {"odometry": 1.0, "regression": 0.5}.items():
            np.testing.assert_allclose(
                found[name], gain * known * first.target, rtol=1e-4, atol=1e-9
            )
    assert (found["train_mean"] == 0.05).all()
    np.testing.assert_allclose(found["persistence"], first.target)
    assert list(baselines(0)) == without + ["odometry", "regression"] * (source == "oxts")


def test_scores_by_hand():
    result = statistics.scores(np.array([0.1, -0.1, 0.2]), np.array([0.1, 0.1, 0.1]))
    assert result["frames"] == 3
    assert result["mse"] == pytest.approx((0 + 0.04 + 0.01) / 3)
    assert result["nmse"] == pytest.approx(0.05 / 0.06)
    assert result["mae"] == pytest.approx(0.1)
    assert result["rmse"] == pytest.approx(np.sqrt(0.05 / 3))
    assert set(statistics.scores(np.empty(0), np.empty(0)).values()) == {0, None}
    steering = np.sin(np.arange(300) / 20)
    assert statistics.scores(steering, 0 * steering)["nmse"] == 1.0
    assert interval(steering, steering, np.zeros(300), 50, 200) == [1.0, 1.0]


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
    assert statistics.untrained(np.array(nmse)) == untrained


def interval(steering, error, drive, block, samples, *other: np.ndarray) -> list[float] | None:
    """Return the interval for errors [N] or [S,N] in rad."""
    squared, *others = (np.atleast_2d(values) ** 2 for values in (error, *other))
    return statistics.interval(squared, steering, drive, settings(block, samples), *others)


def test_intervals_of_paired_differences_have_their_coverage():
    """Twenty drives, and a long one that is cut into parts; errors of two models vary by seed, road
    and both.
    """
    rng = np.random.default_rng(0)
    for drives, frames in ((20, 30), (1, 3000)):
        hits, drive = 0, np.repeat(np.arange(drives), frames)
        road = np.arange(len(drive)) // min(frames, 100)
        for _ in range(60):
            true, models = rng.normal(size=len(drive)), []
            for nmse in (0.146, 0.124):
                spread = sum(
                    rng.normal(-(s**2) / 2, s, n)
                    for s, n in ((0.3, (5, 1)), (0.5, 30), (0.5, (5, 30)))
                )
                models.append(nmse * true**2 * np.exp(spread)[:, road])
            low, high = statistics.interval(
                models[0], true, drive, settings(100, 300), models[1]
            ) or (1, 0)
            hits += low <= 0.146 - 0.124 <= high
        assert 0.88 <= hits / 60 <= 0.99


def test_drives_of_two_or_more_blocks_are_cut_into_equal_parts():
    part = statistics.parts(np.repeat([4, 7, 2, 3], [5, 9, 10, 27]), 5)
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
    low, high = interval(steering, 0 * error, np.zeros(40), 20, 500, error)
    assert (low, high) == pytest.approx((-0.1 - np.sqrt(2) * 0.9, -0.1 + np.sqrt(2) * 0.1))


def test_seeds_of_each_model_are_drawn_independently_of_the_other_model():
    """All roads are equal, so that the interval is that of the mean over seeds, with the deviation
    for n - 1.
    """
    steering, drive, squared = (
        np.full(60, 0.1),
        np.arange(60) // 3,
        [4, 5, 6, 7, 9, 10, 12, 13, 15, 19],
    )
    error = 0.1 * np.sqrt(squared)[:, None] * np.ones(60)
    sigma = np.std(squared, ddof=1) / np.sqrt(10)
    low, high = interval(steering, error, drive, 50, 20_000)
    assert (low, high) == pytest.approx((10 - 1.96 * sigma, 10 + 1.96 * sigma), rel=0.05)
    low, high = interval(steering, error, drive, 50, 20_000, error)
    assert (low, high) == pytest.approx(
        (-1.96 * sigma * np.sqrt(2), 1.96 * sigma * np.sqrt(2)), rel=0.05
    )
    assert interval(steering, error[:1], drive, 50, 500) == pytest.approx([4, 4])


def test_frames_that_do_not_count_keep_their_place_in_time():
    """One frame in 20 counts, two in each of 20 parts; 40 frames alone would be one part."""
    steering, error = np.full(800, 0.1), np.full(800, np.nan)
    error[::20] = 0.1
    assert interval(steering, error, np.zeros(800), block=40, samples=200) == pytest.approx([1, 1])
    rows = np.isfinite(error)
    assert interval(steering[rows], error[rows], np.zeros(40), block=40, samples=200) is None
    assert interval(0 * steering, error, np.zeros(800), block=40, samples=9) is None


def test_the_difference_of_two_models_has_a_narrower_interval():
    rng = np.random.default_rng(0)
    steering, drive = np.sin(np.arange(600) / 30), np.repeat([0, 1], 300)
    hard = np.repeat(rng.uniform(0, 1, 12), 50)  # both err on the same roads
    one, other = (hard * rng.normal(size=(2, 600)) * size for size in (0.5, 0.55))
    low, high = interval(steering, one[:1], drive, 50, 500, other[:1])
    alone = interval(steering, one[:1], drive, 50, 500)
    assert high - low < 0.5 * (alone[1] - alone[0])
    assert interval(steering, one[:1], drive, 50, 500, one[:1]) == [0.0, 0.0]
    # three columns, drawn together
    first, second = (values[:1, :, None] ** 2 * [1, 2, 3] for values in (one, other))
    paired = statistics.interval(
        first, np.stack([steering] * 3, axis=-1), drive, settings(50, 500), second
    )
    assert paired == pytest.approx([2 * low, 2 * high])


# Turns and drift


STEPS = 101  # 10 m/s for 10 s
TIME_S = np.arange(STEPS) / 10


def off(predicted_rad: float, *onsets: int) -> float | None:
    """Return the drift of a constant angle on a straight road."""
    driven = label.Labels(
        np.zeros(STEPS), np.ones(STEPS, bool), np.full(STEPS, 10.0), np.zeros(STEPS)
    )
    drive: Any = SimpleNamespace(
        frame=np.arange(STEPS), time_s=TIME_S, driven=driven, settings=artefacts.LABELS
    )
    return drift([(drive, np.isin(drive.frame, onsets), np.full(STEPS, predicted_rad))])


def test_segments_end_at_onsets_and_missing_predictions():
    predicted = np.zeros(STEPS)
    predicted[:7] = predicted[50] = predicted[99] = np.nan
    found = segments(np.isin(np.arange(STEPS), [3, 20, 50, 70]), predicted)
    assert [(rows[0], rows[-1]) for rows in found] == [(7, 19), (20, 49), (51, 69), (70, 98)]
    assert segments(np.zeros(STEPS, bool), np.full(STEPS, np.nan)) == []


def test_drift_is_the_final_distance_per_100_m():
    assert off(0.0) == 0
    # Small angle ε from L: after s metres off by ε s² / 2 L; 100 m in one piece, or in two of 50
    # and 49 steps.
    assert off(0.01) == pytest.approx(0.01 * 100**2 / 2 / 2.7, rel=0.02)
    assert off(0.01, 50) == pytest.approx(0.01 * (49**2 + 50**2) / 2 / 2.7 / 99 * 100, rel=0.02)
    assert off(np.nan) is None


def test_a_step_uses_speed_and_angle_of_its_end():
    speed, angles, time_s = (
        np.array([9.0, 2.0, 4.0]),
        np.array([9.0, 0.0, 0.1]),
        np.array([0.0, 0.5, 1.0]),
    )
    path = turns.path(angles, speed, time_s, wheelbase_m=2.7)
    turned = 2.0 / 2.7 * np.tan(0.1)
    np.testing.assert_allclose(
        path, [[0, 0], [1, 0], [1 + 2 * np.cos(turned / 2), 2 * np.sin(turned / 2)]]
    )


@pytest.mark.slow
@pytest.mark.real
def test_paths_of_true_angles_follow_gnss(real_kitti, tmp_path):
    """Label, sign and integration at once: GNSS positions are a second route to where the car
    went.
    """
    with tarfile.open(real_kitti / "oxts.tar.gz") as archive:
        archive.extractall(tmp_path, filter="data")
    drives = [KittiDrive(path) for path in sorted(tmp_path.glob("*/*_sync"))]
    means = [
        pieces.mean()
        for drive in drives
        if len(drive.oxts) > 300 and len(pieces := off_the_track(drive))
    ]
    assert len(means) == 30
    # lost satellites, gaps, or a heading off by half a degree
    assert sum(mean > 1 for mean in means) == 7
    assert sorted(means)[-2] < 3  # one drive has no place at first: 44 m off


def off_the_track(raw: KittiDrive) -> np.ndarray:
    """Return how many metres per 100 m the path of true angles ends beside GNSS, for pieces of 100
    m.
    """
    rows = np.array([packets.read_row(path) for path in raw.oxts.values()])
    time_s = packets.read_times(raw.oxts_times, list(raw.oxts))
    lat, lon, yaw, speed = (
        rows[:, packets.COLUMNS.index(name)] for name in ("lat", "lon", "yaw", "vf")
    )
    angle, *_ = label.steering_labels(
        rows[:, packets.MOTION["yaw_rate_radps"]], speed, label.Car(2.7, 1.0)
    )
    # Mercator's, as KITTI's own tools have it: metres at the drive's latitude, x to the east, y to
    # the north.
    radius_m = 6378137.0 * np.cos(np.deg2rad(lat[0]))
    gnss = radius_m * np.stack([np.deg2rad(lon), np.log(np.tan(np.deg2rad(90 + lat) / 2))], axis=1)
    driven_m = np.concatenate([[0.0], np.cumsum(np.abs(speed[1:]) * np.diff(time_s))])
    off = []
    for first in range(0, len(rows), 10):
        last = int(np.searchsorted(driven_m, driven_m[first] + 100))
        if last == len(rows):
            break
        piece = slice(first, last + 1)
        x, y = turns.path(angle[piece], speed[piece], time_s[piece], wheelbase_m=2.7)[-1]
        turned = np.exp(1j * yaw[first]) * complex(x, y)
        step = complex(*(gnss[last] - gnss[first]))
        off.append(100 * abs(turned - step) / (driven_m[last] - driven_m[first]))
    return np.array(off)


STRAIGHT, CORNER = 0.0, 0.1  # 1/m


def bends(*parts: tuple[int, float]) -> np.ndarray:
    """Return curvature for parts of (frames, curvature)."""
    return np.concatenate([np.full(count, curvature) for count, curvature in parts])


def found(curvature: np.ndarray, missing: Sequence[int] = ()) -> list[int]:
    """Return the frames at which turns begin, at 8 m/s."""
    frames = np.setdiff1d(np.arange(len(curvature)), missing)
    curvature, speed = curvature[frames], np.full(len(frames), 8.0)
    labels = label.Labels(curvature, np.ones(len(frames), bool), speed, curvature * speed)
    return frames[turns.onsets(frames / 10, curvature, labels)].tolist()


def test_a_turn_begins_where_the_curvature_leaves_straight():
    turn = np.r_[
        bends((20, STRAIGHT)), np.linspace(0.004, 0.1, 20), bends((20, CORNER), (20, STRAIGHT))
    ]
    assert found(turn) == found(-turn) == [23]
    assert turn[22] < turns.STRAIGHT_1PM < turn[23]


@pytest.mark.parametrize(
    ("curvature", "missing", "onsets"),
    [
        (bends((30, STRAIGHT), (60, 0.03)), (), []),  # a bend of the road
        # around an obstacle
        (bends((30, STRAIGHT), (8, CORNER), (8, -CORNER), (30, STRAIGHT)), (), []),
        (bends((30, CORNER), (5, STRAIGHT), (20, CORNER)), (), []),  # still the same turn
        (bends((30, CORNER), (11, STRAIGHT), (20, -CORNER)), (), [41]),
        (bends((5, STRAIGHT), (20, CORNER)), (), []),  # the drive starts less than a second before
        (bends((30, STRAIGHT), (20, CORNER)), (25,), [30]),  # without a single frame
        (bends((30, STRAIGHT), (20, CORNER)), range(5, 30), []),
        (bends((30, STRAIGHT), (20, CORNER)), range(5, 26), []),
        (np.empty(0), (), []),
    ],
)
def test_only_corners_after_a_straight_second_are_onsets(curvature, missing, onsets):
    assert found(curvature, missing) == onsets
