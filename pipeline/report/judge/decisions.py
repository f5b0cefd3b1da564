"""Where a driver decides: the onset of a turn, which nobody can know who does not know the way.

The rule looks at the recorded steering alone. A turn is a bend of less than TURN's radius, as at a street corner. Its
onset is the frame at which |curvature| leaves STRAIGHT, after a second below it, to reach TURN within REACH_S seconds.
Where the label is invalid, as while the car waits at a corner, the curvature of the last valid frame holds.
"""

import numpy as np

from pipeline.base import store
from pipeline.train.windows import Drive

STRAIGHT_1PM = 0.015  # a radius of 67 m: no corner yet, though a car in its lane moves about as much
TURN_1PM = 0.04  # a radius of 25 m
REACH_S = 2.0
SECOND_S = 1.0


def onsets(curvature_1pm: np.ndarray, valid: np.ndarray, time_s: np.ndarray) -> np.ndarray:
    """Return the rows of the frames [F] of a drive at which a turn begins, by the rule above."""
    last = np.maximum.accumulate(np.where(valid, np.arange(len(valid)), -1))
    bend = np.where(last >= 0, np.abs(curvature_1pm[last]), np.inf)
    straight = bend < STRAIGHT_1PM
    rows = []
    for row in np.flatnonzero(straight[:-1] & ~straight[1:]) + 1:
        before = (time_s >= time_s[row] - SECOND_S) & (time_s < time_s[row])
        after = (time_s >= time_s[row]) & (time_s <= time_s[row] + REACH_S)
        whole = time_s[row] - time_s[0] >= SECOND_S
        if whole and straight[before].all() and bend[after].max() >= TURN_1PM:
            rows.append(row)
    return np.array(rows, np.int64)


def near(drive: Drive) -> np.ndarray:
    """Return which frames [G] of a drive are asked for what its driver has just decided, or is about to.

    Those whose target lies at an onset or after it, while the frame itself is not more than a second past it. So with
    a horizon they begin as much before the onset.
    """
    with store.DriveReader(drive.labels, stage="labels") as truth:
        rows = onsets(truth["curvature_1pm"], truth["valid"].astype(bool), truth.time_s)
        frame, time_s = truth.frame[rows], truth.time_s[rows]
    begun = drive.frame[:, None] + drive.horizon >= frame
    fresh = drive.time_s[:, None] <= time_s + SECOND_S
    return (begun & fresh).any(axis=1)
