"""Where a driver decides: the onset of a turn, which nobody can know who does not know the way.

The rule looks at what was recorded alone. The onset is the frame at which |curvature| leaves STRAIGHT, after a recorded
second below it, if the car turns by TURN within the next REACH metres: as it does at a street corner, and neither in a
bend of the road nor around an obstacle. On KITTI's recorded drives it finds turns by 70° to 100°. Where the label is
invalid, as while the car waits at a corner, the curvature of the last valid frame holds.
"""

import numpy as np

from pipeline.base import store
from pipeline.train.windows import Drive

STRAIGHT_1PM = 0.015  # a radius of 67 m; a car that keeps to its lane moves about as much
TURN_RAD = np.pi / 4
REACH_M = 25.0
SECOND_S = 1.0
KNOWN = 0.75  # share of that second's frames that must be there


def onsets(
    curvature_1pm: np.ndarray,
    valid: np.ndarray,
    time_s: np.ndarray,
    yaw_rate_radps: np.ndarray,
    speed_mps: np.ndarray,
) -> np.ndarray:
    """Return the rows, int64, of the frames [F] of a drive's labels at which a turn begins, by the rule above."""
    last = np.maximum.accumulate(np.where(valid, np.arange(len(valid)), -1))
    straight = np.where(last >= 0, np.abs(curvature_1pm[last]), np.inf) < STRAIGHT_1PM
    dt = np.diff(time_s, prepend=time_s[:1])
    way_m, heading_rad = np.cumsum(np.abs(speed_mps) * dt), np.cumsum(yaw_rate_radps * dt)
    step = np.median(np.diff(time_s)) if len(time_s) > 1 else np.inf
    rows = []
    for row in np.flatnonzero(straight[:-1] & ~straight[1:]) + 1:
        before = (time_s >= time_s[row] - SECOND_S) & (time_s < time_s[row])
        whole = before.sum() >= KNOWN * SECOND_S / step  # at a drive's start, or after a gap, nobody knows
        end = min(np.searchsorted(way_m, way_m[row] + REACH_M), len(way_m) - 1)
        if whole and straight[before].all() and abs(heading_rad[end] - heading_rad[row]) >= TURN_RAD:
            rows.append(row)
    return np.array(rows, np.int64)


def frames(drive: Drive) -> np.ndarray:
    """Return the numbers, int32, of the frames of a drive at which a turn begins."""
    return _onsets(drive)[0]


def near(drive: Drive) -> np.ndarray:
    """Return which frames [G] of a drive are asked for what its driver has just decided, or is about to.

    Those whose target lies at an onset or after it, while the frame itself is not more than a second past it. So with
    a horizon they begin as much before the onset.
    """
    frame, time_s = _onsets(drive)
    begun = drive.frame[:, None] + drive.horizon >= frame
    fresh = drive.time_s[:, None] <= time_s + SECOND_S
    return np.asarray((begun & fresh).any(axis=1))


def _onsets(drive: Drive) -> tuple[np.ndarray, np.ndarray]:
    with store.DriveReader(drive.labels, stage="labels") as truth:
        motion = (truth.time_s, truth["yaw_rate_radps"], truth["speed_mps"])
        rows = onsets(truth["curvature_1pm"], truth["valid"].astype(bool), *motion)
        return truth.frame[rows], truth.time_s[rows]
