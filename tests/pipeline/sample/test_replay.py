"""A replayed drive: the road follows the recorded track, and oxts is copied."""

from pathlib import Path

import numpy as np
import pytest

from pipeline.kitti.oxts import VF, WU, YAW, read_times
from pipeline.kitti.raw import RawDrive
from pipeline.labels.label import steering_labels
from pipeline.sample.drive import Drive
from pipeline.sample.motion import Journey
from pipeline.sample.oxts import read_recording
from pipeline.sample.replay import replay
from tests.recorded_drive import DRIVE, round_the_block, sample_trip, write_recorded

SIZE = (96, 320)


def journey_of(rows: np.ndarray, folder: Path, seed: int = 0) -> Journey:
    recording = read_recording(write_recorded(folder, rows), len(rows))
    return replay(DRIVE, recording, np.random.default_rng(seed), lane_m=3.5)


@pytest.fixture(scope="module")
def trip(tmp_path_factory: pytest.TempPathFactory) -> Journey:
    return journey_of(sample_trip()[0], tmp_path_factory.mktemp("raw"))


@pytest.fixture(scope="module")
def block(tmp_path_factory: pytest.TempPathFactory) -> Journey:
    return journey_of(round_the_block()[0], tmp_path_factory.mktemp("raw"))


def agreement(journey: Journey, rows: np.ndarray) -> tuple[float, float]:
    """Return the correlation of recorded labels with the road's, and the relative squared error."""
    recorded, valid = steering_labels(
        rows[:, WU], rows[:, VF], wheelbase_m=2.7, min_speed_mps=1.0, standstill="invalid"
    )
    road = np.arctan(2.7 * journey.route.curvature(journey.motion.s_m))[valid]
    error = np.mean((road - recorded[valid]) ** 2) / np.mean(recorded[valid] ** 2)
    return float(np.corrcoef(road, recorded[valid])[0, 1]), float(error)


def test_road_has_the_curvature_of_the_labels(trip: Journey, block: Journey) -> None:
    for journey, rows in ((trip, sample_trip()[0]), (block, round_the_block()[0])):
        correlation, error = agreement(journey, rows)
        assert correlation > 0.99
        assert error < 0.01


def test_positions_are_the_recorded_ones_and_on_the_road(trip: Journey) -> None:
    rows, track, driven = sample_trip()
    assert np.linalg.norm(trip.xy - track, axis=1).max() < 0.05
    np.testing.assert_allclose(np.cos(trip.heading_rad - rows[:, YAW]), 1, atol=1e-9)
    on_road, along = trip.route.at(trip.motion.s_m)
    assert np.linalg.norm(trip.xy - on_road, axis=1).max() < 0.3
    assert np.abs(trip.heading_rad - along).max() < np.deg2rad(4)
    # A smooth road is a little shorter than the track; standing and reversing appear in s too.
    assert np.abs(trip.motion.s_m - driven).max() < 0.01 * driven.max()
    assert trip.motion.s_m[125] < trip.motion.s_m[90] - 3
    np.testing.assert_allclose(trip.motion.s_m[75:90], trip.motion.s_m[75], atol=1e-6)


def render(folder: Path, recorded: RawDrive, frames: int) -> RawDrive:
    path = folder / DRIVE[:10] / f"{DRIVE}_sync"
    Drive(DRIVE, frames=frames, size=SIZE, scan_rays=(32, 60), seed=0, recorded=recorded).write(path)
    return RawDrive(path)


def test_rendered_frames_keep_numbers_times_and_packets(tmp_path: Path) -> None:
    recorded = write_recorded(tmp_path / "raw", sample_trip()[0][::20], range(7, 18))
    drive = render(tmp_path / "a", recorded, frames=3)
    for files in (drive.images(2), drive.scans, drive.oxts, drive.truth_depth, drive.truth_cls):
        assert list(files) == [7, 8, 9]
    for frame, path in drive.oxts.items():
        assert path.read_bytes() == recorded.oxts[frame].read_bytes()
    for sensor in ("oxts", "image_02", "velodyne_points"):
        assert (drive.folder / sensor / "timestamps.txt").read_bytes() == recorded.oxts_times.read_bytes()
    np.testing.assert_allclose(read_times(drive.oxts_times, list(drive.oxts)), np.arange(3) * 0.1, atol=1e-9)
