"""Paths of predicted steering: restarts and drift; and the onset of a turn, by hand."""

import tarfile
from pathlib import Path

import numpy as np
import pytest

from pipeline.evaluate import decisions
from pipeline.evaluate.paths import Track, drift, segments
from pipeline.kitti import oxts
from pipeline.kitti.raw import KittiDrive
from pipeline.labels import label
from pipeline.train.labelled_drive import read_drive
from tests import artefacts

STEPS = 101  # 10 m/s for 10 s
TIME_S = np.arange(STEPS) / 10


def track(steering_rad: float | np.ndarray, *onsets: int) -> Track:
    angles = np.broadcast_to(np.asarray(steering_rad, float), STEPS)
    return Track(TIME_S, np.full(STEPS, 10.0), angles, np.array(onsets, int), wheelbase_m=2.7)


def test_segments_end_at_onsets_and_missing_predictions() -> None:
    predicted = np.zeros(STEPS)
    predicted[:7] = predicted[50] = predicted[99] = np.nan
    assert segments(track(0.0, 3, 20, 50, 70), predicted) == [(7, 20), (20, 50), (51, 70), (70, 99)]
    assert segments(track(0.0), np.full(STEPS, np.nan)) == []


def test_drift_is_the_final_distance_per_100_m() -> None:
    right, wrong = np.zeros(STEPS), np.full(STEPS, 0.01)
    assert drift([(track(0.0), right)]) == 0
    # Small angle ε from L: after s metres off by ε s² / 2 L; 100 m in one piece, or in two of 50 and 49 steps.
    assert drift([(track(0.0), wrong)]) == pytest.approx(0.01 * 100**2 / 2 / 2.7, rel=0.02)
    halves = drift([(track(0.0, 50), wrong)])
    assert halves == pytest.approx(0.01 * (49**2 + 50**2) / 2 / 2.7 / 99 * 100, rel=0.02)
    assert drift([(track(0.0), np.full(STEPS, np.nan))]) is None


def test_a_step_uses_speed_and_angle_of_its_end() -> None:
    speed, angles, time_s = np.array([9.0, 2.0, 4.0]), np.array([9.0, 0.0, 0.1]), np.array([0.0, 0.5, 1.0])
    none = np.array([], int)
    path = Track(time_s, speed, angles, none, wheelbase_m=2.7).path(angles, 0, 3)
    turned = 2.0 / 2.7 * np.tan(0.1)
    np.testing.assert_allclose(path, [[0, 0], [1, 0], [1 + 2 * np.cos(turned / 2), 2 * np.sin(turned / 2)]])


@pytest.mark.slow
@pytest.mark.real
def test_paths_of_true_angles_follow_gnss(real_kitti: Path, tmp_path: Path) -> None:
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


NAME = "2026_01_03_drive_0001"
STRAIGHT, CORNER = 0.0, 0.1  # 1/m


def bends(*parts: tuple[int, float]) -> np.ndarray:
    """Return curvature for parts of (frames, curvature)."""
    return np.concatenate([np.full(count, curvature) for count, curvature in parts])


def found(curvature: np.ndarray, valid: np.ndarray | None = None) -> list[int]:
    valid = np.ones(len(curvature), bool) if valid is None else valid
    speed = np.where(valid, 8.0, 0.0)
    return decisions.onsets(curvature, valid, np.arange(len(curvature)) / 10, curvature * speed, speed).tolist()


def test_a_turn_begins_where_the_curvature_leaves_straight() -> None:
    turn = np.r_[bends((20, STRAIGHT)), np.linspace(0.004, 0.1, 20), bends((20, CORNER), (20, STRAIGHT))]
    assert found(turn) == found(-turn) == [23]
    assert turn[22] < decisions.STRAIGHT_1PM < turn[23]


@pytest.mark.parametrize(
    ("curvature", "onsets"),
    [
        (bends((30, STRAIGHT), (60, 0.03)), []),  # a bend of the road
        (bends((30, STRAIGHT), (8, CORNER), (8, -CORNER), (30, STRAIGHT)), []),  # around an obstacle
        (bends((30, CORNER), (5, STRAIGHT), (20, CORNER)), []),  # still the same turn
        (bends((30, CORNER), (11, STRAIGHT), (20, -CORNER)), [41]),
        (bends((5, STRAIGHT), (20, CORNER)), []),  # the drive starts less than a second before
        (bends((30, STRAIGHT)), []),
        (np.empty(0), []),
    ],
)
def test_only_corners_after_a_straight_second_are_onsets(curvature: np.ndarray, onsets: list[int]) -> None:
    assert found(curvature) == onsets


def test_a_gap_before_a_turn_hides_its_onset() -> None:
    turn = bends((30, STRAIGHT), (20, CORNER))
    frames = np.arange(50)

    def found_at(kept: np.ndarray) -> list[int]:
        valid, speed = np.ones(kept.sum(), bool), np.full(kept.sum(), 8.0)
        rows = decisions.onsets(turn[kept], valid, frames[kept] / 10, turn[kept] * speed, speed)
        return frames[kept][rows].tolist()

    assert found_at(frames != 25) == [30]  # a single frame
    assert found_at((frames < 5) | (frames >= 30)) == []
    assert found_at((frames < 5) | (frames >= 26)) == []


@pytest.mark.parametrize(("horizon", "first"), [(0, 30), (10, 20)])
def test_frames_near_an_onset_begin_a_horizon_earlier(tmp_path: Path, horizon: int, first: int) -> None:
    frame = np.arange(80)
    steering = np.arctan(artefacts.WHEELBASE_M * bends((30, STRAIGHT), (20, -CORNER), (30, STRAIGHT)))
    artefacts.write_labels(tmp_path / f"labels/{NAME}.h5", NAME, steering, frame)
    artefacts.write_graphs(tmp_path / f"graphs/{NAME}.h5", NAME, steering, frame, 8, np.random.default_rng(0))
    drive = read_drive(tmp_path / "graphs", tmp_path / "labels", NAME, horizon)
    assert np.flatnonzero(decisions.near_onsets(drive, decisions.read_turns(drive))[:, 0]).tolist() == list(
        range(first, 41)
    )


def test_a_path_is_masked_from_where_it_reaches_an_onset(tmp_path: Path) -> None:
    """At 8 m/s and 10 Hz a frame is 0.8 m, so the far edges are 5 and 25 frames before the onset at frame 30."""
    frame, edges_m = np.arange(80), [0, 4, 20]
    steering = np.arctan(artefacts.WHEELBASE_M * bends((30, STRAIGHT), (20, -CORNER), (30, STRAIGHT)))
    artefacts.write_labels(tmp_path / f"labels/{NAME}.h5", NAME, steering, frame, ahead_m=edges_m)
    artefacts.write_graphs(tmp_path / f"graphs/{NAME}.h5", NAME, steering, frame, 8, np.random.default_rng(0))
    drive = read_drive(tmp_path / "graphs", tmp_path / "labels", NAME, predict="path")
    turns = decisions.read_turns(drive)
    assert turns.frame.tolist() == [30]
    near, far = decisions.near_onsets(drive, turns).T
    assert frame[near].tolist() == pytest.approx(np.arange(25, 41), abs=1)
    assert frame[far].tolist() == pytest.approx(np.arange(5, 41), abs=1)
