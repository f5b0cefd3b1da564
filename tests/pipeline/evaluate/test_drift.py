"""The path of angles, and the drift of a predicted path."""

import tarfile

import numpy as np
import pandas as pd
import pytest

from pipeline.evaluate.drift import find_ways, integrate_path, measure_drift
from pipeline.ingest import packets
from pipeline.ingest.datasets.kitti import KittiDrive
from pipeline.labels import label

STEPS = 101  # 10 m/s for 10 s
FRAMES = pd.DataFrame(
    {"frame": np.arange(STEPS), "time_s": np.arange(STEPS) / 10, "speed_mps": 10.0}
)


def off(
    predicted_rad: float,
    unlabelled: int | None = None,
    lost: int | None = None,
    frames: pd.DataFrame = FRAMES,
) -> float | None:
    """Return the drift of a constant angle on a straight road, with a frame that has no label.

    A frame that is lost has no row.
    """
    true_rad = np.where(np.arange(STEPS) == unlabelled, np.nan, 0.0)
    rows = np.delete(np.arange(STEPS), [] if lost is None else lost)
    drive = np.zeros(len(rows), int)
    predicted = np.full(len(rows), predicted_rad)
    car = label.Car(2.7, 1.0)
    return measure_drift(true_rad[rows], predicted, drive, frames.iloc[rows], car)


def test_ways_end_with_their_drive_and_where_a_label_or_a_prediction_is_missing():
    known = np.ones(STEPS, bool)
    known[:7] = False
    known[[20, 50, 99]] = False
    drive = np.arange(STEPS) // 60
    # Frame 35 of the first drive is lost.
    frame = np.arange(STEPS) % 60 + (np.arange(STEPS) >= 35)
    pieces = [(rows[0], rows[-1]) for rows in find_ways(drive, frame, known)]
    assert pieces == [(7, 19), (21, 34), (35, 49), (51, 59), (60, 98)]
    assert find_ways(drive, frame, np.zeros(STEPS, bool)) == []


def test_drift_is_the_final_distance_per_100_m():
    assert off(0.0) == 0
    # Small angle ε from L: after s metres off by ε s² / 2 L; 100 m in one piece, or in two of 49
    # steps each.
    assert off(0.01) == pytest.approx(0.01 * 100**2 / 2 / 2.7, rel=0.02)
    assert off(0.01, 50) == pytest.approx(0.01 * 49 * 100 / 2 / 2.7, rel=0.02)
    assert off(0.01, lost=50) == off(0.01, 50)
    assert off(np.nan) is None


def test_a_frame_of_unknown_speed_ends_a_way_as_one_without_a_label_does():
    speed_mps = np.where(np.arange(STEPS) == 50, np.nan, 10.0)
    assert off(0.01, frames=FRAMES.assign(speed_mps=speed_mps)) == off(0.01, unlabelled=50)
    assert off(0.01, frames=FRAMES.assign(speed_mps=np.nan)) is None


def test_a_step_uses_speed_and_angle_of_its_end():
    speed_mps = np.array([9.0, 2.0, 4.0])
    angles_rad = np.array([9.0, 0.0, 0.1])
    time_s = np.array([0.0, 0.5, 1.0])
    positions_m = integrate_path(angles_rad, speed_mps, time_s, wheelbase_m=2.7)
    halfway_rad = 2.0 / 2.7 * np.tan(0.1) / 2
    end = [1 + 2 * np.cos(halfway_rad), 2 * np.sin(halfway_rad)]
    np.testing.assert_allclose(positions_m, [[0, 0], [1, 0], end])


@pytest.mark.slow
@pytest.mark.real
def test_paths_of_true_angles_follow_gnss(real_kitti, tmp_path):
    """Label, sign and integration at once: GNSS is a second route to where the car went."""
    with tarfile.open(real_kitti / "oxts.tar.gz") as archive:
        archive.extractall(tmp_path, filter="data")
    means = []
    for folder in sorted(tmp_path.glob("*/*_sync")):
        drive = KittiDrive(folder)
        if len(drive.oxts) > 300:
            pieces = off_the_track(drive)
            if len(pieces):
                means.append(pieces.mean())
    assert len(means) == 30
    # lost satellites, gaps, or a heading off by half a degree
    assert sum(mean > 1 for mean in means) == 7
    assert sorted(means)[-2] < 3  # one drive has no place at first: 44 m off


def off_the_track(raw: KittiDrive) -> np.ndarray:
    """Return how far the path of true angles ends beside GNSS, in metres per piece of 100 m."""
    rows = np.array([packets.read_packet(packet) for packet in raw.oxts.values()])
    time_s = packets.read_times(raw.oxts_times, list(raw.oxts))
    columns = dict(zip(packets.COLUMNS, rows.T, strict=True))
    speed_mps = columns["vf"]
    labels = label.steering_labels(columns["wu"], speed_mps, label.Car(2.7, 1.0))

    # Mercator's, as KITTI's own tools have it: metres at the drive's latitude, east + north i.
    radius_m = 6378137.0 * np.cos(np.deg2rad(columns["lat"][0]))
    east = np.deg2rad(columns["lon"])
    north = np.log(np.tan(np.deg2rad(90 + columns["lat"]) / 2))
    gnss_m = radius_m * (east + 1j * north)

    steps_m = np.abs(speed_mps[1:]) * np.diff(time_s)
    driven_m = np.concatenate([[0.0], np.cumsum(steps_m)])
    errors_m = []
    for first in range(0, len(rows), 10):
        last = int(np.searchsorted(driven_m, driven_m[first] + 100))
        if last == len(rows):
            break
        piece = slice(first, last + 1)
        angle_rad = labels.steering_rad[piece]
        path_m = integrate_path(angle_rad, speed_mps[piece], time_s[piece], wheelbase_m=2.7)
        end_m = np.exp(1j * columns["yaw"][first]) * complex(*path_m[-1])
        error_m = abs(end_m - (gnss_m[last] - gnss_m[first]))
        errors_m.append(100 * error_m / (driven_m[last] - driven_m[first]))
    return np.array(errors_m)
