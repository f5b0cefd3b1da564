"""The onset of a turn, by hand."""

from pathlib import Path

import numpy as np
import pytest

from pipeline.evaluate import decisions
from pipeline.train.labelled_drive import read_drive
from tests import artefacts

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
