"""Paths of predicted steering: restarts and drift."""

import tarfile
from pathlib import Path

import numpy as np
import pytest

from pipeline.evaluate.paths import Track, drift, segments
from pipeline.kitti import oxts
from pipeline.kitti.raw import KittiDrive
from pipeline.labels import label

STEPS = 101  # 10 m/s for 10 s
TIME_S = np.arange(STEPS) / 10


def track(steering_rad: float | np.ndarray, *onsets: int) -> Track:
    angles = np.broadcast_to(np.asarray(steering_rad, float), STEPS)
    return Track(TIME_S, np.full(STEPS, 10.0), angles, np.array(onsets, int), wheelbase_m=2.7)


def test_a_path_starts_at_the_true_pose() -> None:
    bend = track(0.1)
    whole = bend.path(bend.steering_rad, 0, STEPS)
    np.testing.assert_allclose(bend.path(bend.steering_rad, 40, 70), whole[40:70], atol=1e-9)
    # A circle of radius L / tan Θ, to the left.
    radius = 2.7 / np.tan(0.1)
    np.testing.assert_allclose(np.hypot(whole[:, 0], whole[:, 1] - radius), radius, rtol=1e-3)
    straight = bend.path(np.zeros(STEPS), 40, 70)
    ahead = np.diff(straight, axis=0)
    assert np.allclose(ahead, ahead[0])
    turned = 40 * np.tan(0.1) / 2.7
    np.testing.assert_allclose(ahead[0], [np.cos(turned), np.sin(turned)], atol=1e-9)


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
    # The paper's formula: the angle is the heading.
    path = Track(time_s, speed, angles, none, wheelbase_m=2.7, formula="paper").path(angles, 0, 3)
    np.testing.assert_allclose(path, [[0, 0], [1, 0], [1 + 2 * np.cos(0.1), 2 * np.sin(0.1)]])


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
