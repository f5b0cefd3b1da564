"""Find the onsets of turns: frames at which the driver chooses a way that the scene does not determine.

The rule uses recorded motion only. An onset is the frame at which |curvature| exceeds STRAIGHT_1PM after one second
below it, if the car turns by at least TURN_RAD within the next REACH_M metres: a turn at a street corner, no bend of
the road and no manoeuvre around an obstacle. On KITTI's drives it finds turns of 70° to 100°. Where the label is
invalid, for instance while the car waits at a corner, the curvature of the last valid frame is used.
"""

from typing import NamedTuple

import numpy as np

from pipeline.base import store
from pipeline.train.labelled_drive import LabelledDrive

STRAIGHT_1PM = 0.015  # radius 67 m; a car that keeps its lane stays below
TURN_RAD = np.pi / 4
REACH_M = 25.0
SECOND_S = 1.0
MIN_FRAMES = 0.75  # least share of the frames of this second


def onsets(
    curvature_1pm: np.ndarray,
    valid: np.ndarray,
    time_s: np.ndarray,
    yaw_rate_radps: np.ndarray,
    speed_mps: np.ndarray,
) -> np.ndarray:
    """Return the rows, int64, at which a turn begins, for the labels [F] of a drive."""
    last = np.maximum.accumulate(np.where(valid, np.arange(len(valid)), -1))
    straight = np.where(last >= 0, np.abs(curvature_1pm[last]), np.inf) < STRAIGHT_1PM
    dt = np.diff(time_s, prepend=time_s[:1])
    distance_m, heading_rad = np.cumsum(np.abs(speed_mps) * dt), np.cumsum(yaw_rate_radps * dt)
    step = np.median(np.diff(time_s)) if len(time_s) > 1 else np.inf
    rows = []
    for row in np.flatnonzero(straight[:-1] & ~straight[1:]) + 1:
        before = (time_s >= time_s[row] - SECOND_S) & (time_s < time_s[row])
        complete = before.sum() >= MIN_FRAMES * SECOND_S / step  # false at the start of a drive and after a gap
        end = min(np.searchsorted(distance_m, distance_m[row] + REACH_M), len(distance_m) - 1)
        if complete and straight[before].all() and abs(heading_rad[end] - heading_rad[row]) >= TURN_RAD:
            rows.append(row)
    return np.array(rows, np.int64)


class Turns(NamedTuple):
    """Onsets of the turns in a drive."""

    frame: np.ndarray  # int32
    time_s: np.ndarray


def read_turns(drive: LabelledDrive) -> Turns:
    """Return the onsets in a drive's labels."""
    with store.DriveReader(drive.labels, stage="labels") as labels:
        motion = (labels.time_s, labels["yaw_rate_radps"], labels["speed_mps"])
        rows = onsets(labels["curvature_1pm"], labels["valid"].astype(bool), *motion)
        return Turns(labels.frame[rows], labels.time_s[rows])


def near_onsets(drive: LabelledDrive, turns: Turns) -> np.ndarray:
    """Return the mask [G,R] of a drive's frames that are close to an onset, for each column.

    The target of such a frame is at an onset or later, or its path reaches an onset before the range's far edge; and
    the frame itself is at most one second after the onset.
    """
    if drive.ahead_m:
        driven_m = np.abs(drive.speed_mps[1:]) * np.diff(drive.time_s)
        at_m = np.concatenate([[0.0], np.cumsum(driven_m)])[: len(drive.frame)]
        reached_m = at_m[:, None, None] + np.array(drive.ahead_m[1:])[:, None]  # [G,R,1]
        begun = reached_m >= np.interp(turns.time_s, drive.time_s, at_m)
    else:
        begun = (drive.frame[:, None] + drive.horizon >= turns.frame)[:, None]
    recent = drive.time_s[:, None] <= turns.time_s + SECOND_S
    return np.asarray((begun & recent[:, None]).any(axis=2))
