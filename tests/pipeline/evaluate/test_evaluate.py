"""Metrics of a split: counted frames, drives, baselines; errors and their intervals; onsets of turns and drift."""

import tarfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pipeline.base.params import load
from pipeline.evaluate import errors, metrics, turns
from pipeline.evaluate.turns import Track, drift, segments
from pipeline.kitti import oxts
from pipeline.kitti.raw import KittiDrive
from pipeline.labels import label
from pipeline.settings.evaluate import Evaluate
from pipeline.train.labelled_drive import LabelledDrive, read_drive
from pipeline.train.scale import Prediction, Scale
from tests import artefacts
from tests.small_model import entry

PARAMS = Path(__file__).resolve().parents[3] / "params.yaml"
NAMES = ["2026_01_03_drive_0001", "2026_01_03_drive_0002"]


def read(folder: Path, horizon: int = 0) -> list[LabelledDrive]:
    return [read_drive(folder / "graphs/semantic", folder / "labels", name, entry(horizon=horizon)) for name in NAMES]


@pytest.fixture
def folder(tmp_path) -> Path:
    artefacts.write_dataset(tmp_path, dict.fromkeys(NAMES, "test"), frames=30, points=40)
    return tmp_path


def case(drive: LabelledDrive, *seeds: np.ndarray, mean: float = 0.0) -> metrics.Case:
    gain = None if drive.odometry is None else np.array([0.5])
    scale = Scale(["steering_rad"], np.ones(1), np.ones(1), np.array([mean]), gain)
    return metrics.Case(drive, [Prediction(angles) for angles in seeds], scale)


def scores(cases: list[metrics.Case]) -> dict[str, Any]:
    return metrics.metrics(cases, load(Evaluate, PARAMS))["steering_rad"]


def test_invalid_and_early_frames_do_not_count(folder):
    test = read(folder)
    test[0].valid[10:15] = False
    predicted = [drive.target + 0.01 for drive in test]
    for angles, drive in zip(predicted, test, strict=True):
        angles[:3] = np.nan
        angles[~drive.valid] = 99.0
    cases = [case(drive, angles) for drive, angles in zip(test, predicted, strict=True)]
    blocks = load(Evaluate, PARAMS).model_copy(update={"bootstrap_block_frames": 5})
    found = metrics.metrics(cases, blocks)["steering_rad"]
    assert found["frames"] == 2 * (30 - 3) - 5
    assert found["mse"] == pytest.approx(0.01**2)
    assert found["nmse_ci95"][0] <= found["nmse"] <= found["nmse_ci95"][1]
    assert found["baselines"]["train_mean"] == found["baselines"]["zero"]
    assert found["nmse_std"] is None
    assert [row["from_1pm"] for row in found["by_curvature"]] == [0.0, 0.005, 0.03]
    for row in found["by_curvature"]:
        inside = [d.valid & (np.abs(d.curvature_1pm) >= row["from_1pm"]) for d in test]
        inside = [m & (np.abs(d.curvature_1pm) < (row["to_1pm"] or 9)) for m, d in zip(inside, test, strict=True)]
        angles = np.concatenate([d.target[3:][m[3:]] for m, d in zip(inside, test, strict=True)])
        assert row["frames"] == len(angles) > 0
        assert row["baselines"]["zero"]["mse"] == pytest.approx(np.mean(angles**2))
        counts = np.concatenate([m & (np.arange(30) >= 3)[:, None] for m in inside])[:, 0]  # others keep their place
        truth, number = np.concatenate([drive.target[:, 0] for drive in test]), np.repeat([0, 1], 30)
        error = np.where(counts, 0.01**2, np.nan)
        assert row["nmse_ci95"] == pytest.approx(errors.interval(error, truth, number, blocks))


def test_each_drive_has_its_own_errors_and_training_mean(folder):
    first, second = read(folder, horizon=2)
    cases = [
        case(first, first.target + 0.01, first.target + 0.03),
        case(second, second.target, second.target, mean=0.05),
    ]
    found = scores(cases)["by_drive"]
    assert list(found) == NAMES
    assert found[NAMES[0]]["frames"] == 28  # the last two have no label 2 frames ahead
    assert found[NAMES[0]]["mse"] == pytest.approx((0.01**2 + 0.03**2) / 2)
    assert found[NAMES[1]]["nmse"] == 0
    truth, baselines = second.target[:28], found[NAMES[1]]["baselines"]
    assert baselines["train_mean"]["mse"] == pytest.approx(np.mean((truth - 0.05) ** 2))
    assert baselines["persistence"]["mse"] == pytest.approx(np.mean((truth - second.persistence[:28]) ** 2))


@pytest.mark.parametrize("source", ["oxts", "visual"])
def test_odometry_needs_motion_in_all_drives_and_other_labels(folder, monkeypatch, source):
    """At horizon 0, labels from visual odometry are not compared with it."""
    monkeypatch.setitem(artefacts.LABELS["labels"], "source", source)
    without = ["zero", "train_mean", "persistence"]

    def baselines(horizon: int, *measured: bool) -> dict[str, Any]:
        """Return the baselines if the drives have motion, measured in all frames or in none."""
        artefacts.write_dataset(folder, dict.fromkeys(NAMES, "test"), frames=30, points=40)
        for drive, valid in zip(read(folder), measured, strict=False):
            artefacts.add_motion(drive.graphs, drive.target[:, 0], np.full(30, valid))
        return scores([case(drive, np.zeros((30, 1))) for drive in read(folder, horizon)])["baselines"]

    assert list(baselines(5)) == list(baselines(5, True)) == without
    assert baselines(5, True, False)["odometry"]["nmse"] is None
    found = baselines(5, True, True)
    assert list(found) == [*without, "odometry", "regression"]
    for name, gain in {"odometry": 1.0, "regression": 0.5}.items():
        ahead = np.concatenate([drive.target[5:] - gain * drive.target[:25] for drive in read(folder)])
        assert found[name]["mse"] == pytest.approx(np.mean(ahead**2), rel=1e-4)
    assert list(baselines(0, True, True)) == without + ["odometry", "regression"] * (source == "oxts")


def test_scores_by_hand():
    result = errors.scores(np.array([0.1, -0.1, 0.2]), np.array([0.1, 0.1, 0.1]))
    assert result["frames"] == 3
    assert result["mse"] == pytest.approx((0 + 0.04 + 0.01) / 3)
    assert result["nmse"] == pytest.approx(0.05 / 0.06)
    assert result["mae"] == pytest.approx(0.1)
    assert result["rmse"] == pytest.approx(np.sqrt(0.05 / 3))
    assert set(errors.scores(np.empty(0), np.empty(0)).values()) == {0, None}
    steering = np.sin(np.arange(300) / 20)
    assert errors.scores(steering, 0 * steering)["nmse"] == 1.0
    assert interval(steering, steering, np.zeros(300), 50, 200) == [1.0, 1.0]


def settings(block: int, samples: int) -> Evaluate:
    return Evaluate(bootstrap_block_frames=block, bootstrap_samples=samples, curvature_bins_1pm=[0.1], seed=0)


def interval(steering: np.ndarray, error: np.ndarray, drive: np.ndarray, block: int, samples: int) -> list[float]:
    """Return the interval for errors [N] or [S,N] in rad."""
    return errors.interval(np.atleast_2d(error**2).mean(axis=0), steering, drive, settings(block, samples))


def test_interval_has_its_coverage():
    """Errors are correlated over 10 frames; the interval contains the true ratio in most repetitions."""
    hits = 0
    for seed in range(30):
        rng = np.random.default_rng(seed)
        noise = np.convolve(rng.normal(size=620), np.ones(10) / np.sqrt(10), "valid")[:600]
        steering = np.convolve(rng.normal(size=620), np.ones(10) / np.sqrt(10), "valid")[:600]
        low, high = interval(steering, 0.5 * noise, np.zeros(600), 50, 400)
        hits += low <= 0.25 <= high
    assert 24 <= hits <= 30


def test_interval_draws_drives_and_circular_blocks_within_them():
    steering = np.concatenate([np.full(20, 0.1), np.full(20, 0.3)])
    error = np.concatenate([np.full(20, 0.1), np.zeros(20)])
    drive = np.repeat([0, 1], 20)
    low, high = interval(steering, error, drive, block=20, samples=500)
    # Two drives are drawn, each complete: error ratios 1, 0.1 (one of each) and 0.
    assert (low, high) == (0.0, pytest.approx(1.0))
    assert interval(steering, error, drive, block=500, samples=500) == [low, high]
    # All of the error is in the last row: blocks that do not wrap around would rarely contain it.
    steering, drive = np.full(60, 0.1), np.zeros(60)
    error = np.zeros(60)
    error[-1] = 0.1
    low, high = interval(steering, error, drive, block=20, samples=2000)
    assert (low, high) == (0.0, pytest.approx(3 / 60))


def test_frames_that_do_not_count_keep_their_place_in_time():
    """One frame in 20 counts, so that each of 40 blocks of 20 draws one; two blocks of counted frames draw 20 each."""
    steering, error = np.full(800, 0.1), np.full(800, np.nan)
    error[::20] = 0
    error[0] = 0.1
    assert interval(steering, error, np.zeros(800), block=20, samples=2000) == pytest.approx([0, 3 / 40])
    rows = np.isfinite(error)
    assert interval(steering[rows], error[rows], np.zeros(40), block=20, samples=2000) == pytest.approx([0, 2 / 40])


def test_the_difference_of_two_models_has_a_narrower_interval():
    rng = np.random.default_rng(0)
    steering, drive = np.sin(np.arange(600) / 30), np.repeat([0, 1], 300)
    hard = np.repeat(rng.uniform(0, 1, 12), 50)  # both err on the same roads
    one, other = (hard * rng.normal(size=(2, 600)) * size for size in (0.5, 0.55))
    difference = (one**2 - other**2).mean(axis=0)
    low, high = errors.interval(difference, steering, drive, settings(50, 500))
    alone = interval(steering, one, drive, 50, 500)
    assert high - low < 0.5 * (alone[1] - alone[0])
    assert errors.interval(0 * difference, steering, drive, settings(50, 500)) == [0.0, 0.0]
    columns = np.stack([difference] * 3, axis=1), np.stack([steering] * 3, axis=1)  # drawn together
    assert errors.interval(*columns, drive, settings(50, 500)) == pytest.approx([low, high])


def test_a_single_block_has_no_interval():
    steering, drive = np.linspace(0.1, 0.2, 51), np.zeros(51)
    error = np.linspace(0, 0.1, 51)
    assert interval(steering[:50], error[:50], drive[:50], block=50, samples=50) is None
    low, high = interval(steering, error, drive, block=50, samples=50)
    assert low < high
    low, high = interval(steering[:50], error[:50], np.repeat([0, 1], 25), block=50, samples=50)
    assert low < high


def test_scores_of_normal_errors_with_known_sigma():
    rng = np.random.default_rng(0)
    sigma = rng.choice([0.01, 0.01, 0.04], size=(2, 50_000))
    steering = np.zeros(50_000)
    found = errors.uncertainty(steering, steering + sigma * rng.standard_normal(sigma.shape), sigma, 1.96 * sigma)
    assert found["coverage_68"] == pytest.approx(0.6827, abs=0.01)
    assert found["coverage_95"] == pytest.approx(0.95, abs=0.01)
    entropy = np.log(2 * np.pi * np.e) / 2
    assert found["nll"] == pytest.approx(np.mean(np.log([0.01, 0.01, 0.04])) + entropy, abs=0.01)
    assert found["nll_constant"] == pytest.approx(
        np.log(np.sqrt(np.mean([0.01**2, 0.01**2, 0.04**2]))) + entropy, abs=0.01
    )
    assert found["mae_certain"] == pytest.approx(np.sqrt(2 / np.pi) * 0.01, rel=0.02)


# Turns and drift


STEPS = 101  # 10 m/s for 10 s
TIME_S = np.arange(STEPS) / 10


def track(steering_rad: float | np.ndarray, *onsets: int) -> Track:
    angles = np.broadcast_to(np.asarray(steering_rad, float), STEPS)
    return Track(TIME_S, np.full(STEPS, 10.0), angles, np.array(onsets, int), wheelbase_m=2.7)


def test_segments_end_at_onsets_and_missing_predictions():
    predicted = np.zeros(STEPS)
    predicted[:7] = predicted[50] = predicted[99] = np.nan
    assert segments(track(0.0, 3, 20, 50, 70), predicted) == [(7, 20), (20, 50), (51, 70), (70, 99)]
    assert segments(track(0.0), np.full(STEPS, np.nan)) == []


def test_drift_is_the_final_distance_per_100_m():
    right, wrong = np.zeros(STEPS), np.full(STEPS, 0.01)
    assert drift([(track(0.0), right)]) == 0
    # Small angle ε from L: after s metres off by ε s² / 2 L; 100 m in one piece, or in two of 50 and 49 steps.
    assert drift([(track(0.0), wrong)]) == pytest.approx(0.01 * 100**2 / 2 / 2.7, rel=0.02)
    halves = drift([(track(0.0, 50), wrong)])
    assert halves == pytest.approx(0.01 * (49**2 + 50**2) / 2 / 2.7 / 99 * 100, rel=0.02)
    assert drift([(track(0.0), np.full(STEPS, np.nan))]) is None


def test_a_step_uses_speed_and_angle_of_its_end():
    speed, angles, time_s = np.array([9.0, 2.0, 4.0]), np.array([9.0, 0.0, 0.1]), np.array([0.0, 0.5, 1.0])
    none = np.array([], int)
    path = Track(time_s, speed, angles, none, wheelbase_m=2.7).path(angles, 0, 3)
    turned = 2.0 / 2.7 * np.tan(0.1)
    np.testing.assert_allclose(path, [[0, 0], [1, 0], [1 + 2 * np.cos(turned / 2), 2 * np.sin(turned / 2)]])


@pytest.mark.slow
@pytest.mark.real
def test_paths_of_true_angles_follow_gnss(real_kitti, tmp_path):
    """Label, sign and integration at once: GNSS positions are a second route to where the car went."""
    with tarfile.open(real_kitti / "oxts.tar.gz") as archive:
        archive.extractall(tmp_path, filter="data")
    drives = [KittiDrive(path) for path in sorted(tmp_path.glob("*/*_sync"))]
    means = [pieces.mean() for drive in drives if len(drive.oxts) > 300 and len(pieces := off_the_track(drive))]
    assert len(means) == 30
    assert sum(mean > 1 for mean in means) == 7  # lost satellites, gaps, or a heading off by half a degree
    assert sorted(means)[-2] < 3  # one drive has no place at first: 44 m off


def off_the_track(raw: KittiDrive) -> np.ndarray:
    """Return how many metres per 100 m the path of true angles ends beside GNSS, for pieces of 100 m."""
    rows = np.array([oxts.read_row(path) for path in raw.oxts.values()])
    time_s = oxts.read_times(raw.oxts_times, list(raw.oxts))
    lat, lon, yaw, speed = (rows[:, oxts.COLUMNS.index(name)] for name in ("lat", "lon", "yaw", "vf"))
    angle, _ = label.steering_labels(rows[:, oxts.WU], speed, wheelbase_m=2.7, min_speed_mps=1.0)
    # Mercator's, as KITTI's own tools have it: metres at the drive's latitude, x to the east, y to the north.
    radius_m = 6378137.0 * np.cos(np.deg2rad(lat[0]))
    gnss = radius_m * np.stack([np.deg2rad(lon), np.log(np.tan(np.deg2rad(90 + lat) / 2))], axis=1)
    driven_m = np.concatenate([[0.0], np.cumsum(np.abs(speed[1:]) * np.diff(time_s))])
    off = []
    for first in range(0, len(rows), 10):
        last = int(np.searchsorted(driven_m, driven_m[first] + 100))
        if last == len(rows):
            break
        piece = slice(first, last + 1)
        own = Track(time_s[piece], speed[piece], angle[piece], np.array([], int), wheelbase_m=2.7)
        x, y = own.path(own.steering_rad, 0, last + 1 - first)[-1]
        turned = np.exp(1j * yaw[first]) * complex(x, y)
        step = complex(*(gnss[last] - gnss[first]))
        off.append(100 * abs(turned - step) / (driven_m[last] - driven_m[first]))
    return np.array(off)


STRAIGHT, CORNER = 0.0, 0.1  # 1/m


def bends(*parts: tuple[int, float]) -> np.ndarray:
    """Return curvature for parts of (frames, curvature)."""
    return np.concatenate([np.full(count, curvature) for count, curvature in parts])


def found(curvature: np.ndarray, kept: np.ndarray | slice = slice(None)) -> list[int]:
    frames, speed = np.arange(len(curvature))[kept], np.full(len(curvature), 8.0)[kept]
    curvature, valid = curvature[kept], np.ones(len(frames), bool)
    return frames[turns.onsets(curvature, valid, frames / 10, curvature * speed, speed)].tolist()


def test_a_turn_begins_where_the_curvature_leaves_straight():
    turn = np.r_[bends((20, STRAIGHT)), np.linspace(0.004, 0.1, 20), bends((20, CORNER), (20, STRAIGHT))]
    assert found(turn) == found(-turn) == [23]
    assert turn[22] < turns.STRAIGHT_1PM < turn[23]


@pytest.mark.parametrize(
    ("curvature", "onsets"),
    [
        (bends((30, STRAIGHT), (60, 0.03)), []),  # a bend of the road
        (bends((30, STRAIGHT), (8, CORNER), (8, -CORNER), (30, STRAIGHT)), []),  # around an obstacle
        (bends((30, CORNER), (5, STRAIGHT), (20, CORNER)), []),  # still the same turn
        (bends((30, CORNER), (11, STRAIGHT), (20, -CORNER)), [41]),
        (bends((5, STRAIGHT), (20, CORNER)), []),  # the drive starts less than a second before
        (np.empty(0), []),
    ],
)
def test_only_corners_after_a_straight_second_are_onsets(curvature, onsets):
    assert found(curvature) == onsets


def test_a_gap_before_a_turn_hides_its_onset():
    turn, frames = bends((30, STRAIGHT), (20, CORNER)), np.arange(50)
    assert found(turn, frames != 25) == [30]  # a single frame
    assert found(turn, (frames < 5) | (frames >= 30)) == []
    assert found(turn, (frames < 5) | (frames >= 26)) == []


def around_a_corner(folder: Path, **reading: object) -> LabelledDrive:
    """Return a drive whose turn begins at frame 30 and ends at frame 50."""
    frame, path = np.arange(80), f"{NAMES[0]}.h5"
    steering = np.arctan(artefacts.WHEELBASE_M * bends((30, STRAIGHT), (20, -CORNER), (30, STRAIGHT)))
    artefacts.write_labels(folder / "labels" / path, NAMES[0], steering, frame, ahead_m=[0, 4, 20])
    artefacts.write_graphs(folder / "graphs" / path, NAMES[0], steering, frame, 8, np.random.default_rng(0))
    drive = read_drive(folder / "graphs", folder / "labels", NAMES[0], entry(**reading))
    assert turns.read_turns(drive).frame.tolist() == [30]
    return drive


@pytest.mark.parametrize(("horizon", "first"), [(0, 30), (10, 20)])
def test_frames_near_an_onset_begin_a_horizon_earlier(tmp_path, horizon, first):
    drive = around_a_corner(tmp_path, horizon=horizon)
    near = turns.near_onsets(drive, turns.read_turns(drive))[:, 0]
    assert np.flatnonzero(near).tolist() == list(range(first, 41))


def test_a_path_is_masked_from_where_it_reaches_an_onset(tmp_path):
    """At 8 m/s and 10 Hz a frame is 0.8 m, so the far edges are 5 and 25 frames before the onset at frame 30."""
    drive = around_a_corner(tmp_path, predict="path")
    near, far = turns.near_onsets(drive, turns.read_turns(drive)).T
    assert np.flatnonzero(near).tolist() == pytest.approx(np.arange(25, 41), abs=1)
    assert np.flatnonzero(far).tolist() == pytest.approx(np.arange(5, 41), abs=1)
