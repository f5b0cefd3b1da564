"""Find the onsets of turns, and compute the drift of predicted paths.

At an onset, the driver chooses a way that the scene does not determine. The rule uses recorded
motion only. An onset is the frame at which |curvature| exceeds STRAIGHT_1PM
after one second below it, if the car turns by at least TURN_RAD within the next REACH_M metres: a
turn at a street corner, no bend of the road and no manoeuvre around an obstacle. On KITTI's drives
it finds turns of 70° to 100°. Where the label is invalid, for instance while the car waits at a
corner, the curvature of the last valid frame is used.
"""

from collections.abc import Iterable

import numpy as np

from pipeline.base import store
from pipeline.labels import label
from pipeline.train.targets import LabelledDrive

# Largest curvature of a straight stretch, a radius of 67 m; a car that keeps its lane stays below.
STRAIGHT_1PM = 0.015
# Least turn in rad within REACH_M.
TURN_RAD = np.pi / 4
# Length in metres of the way in which the car turns.
REACH_M = 25.0
# Time in seconds of the straight stretch before a turn.
SECOND_S = 1.0
# Least share of the frames of this second that are there.
MIN_FRAMES = 0.75


def onsets(time_s: np.ndarray, curvature_1pm: np.ndarray, labels: label.Labels) -> np.ndarray:
    """Return the rows, int64, at which a turn begins, for the frames [F] of a drive."""
    curvature_1pm = label.hold_valid(np.abs(curvature_1pm), labels.valid, initial=np.inf)
    straight = curvature_1pm < STRAIGHT_1PM
    dt_s = np.diff(time_s, prepend=time_s[:1])
    distance_m = np.cumsum(np.abs(labels.speed_mps) * dt_s)
    heading_rad = np.cumsum(labels.yaw_rate_radps * dt_s)
    step_s = np.median(np.diff(time_s)) if len(time_s) > 1 else np.inf

    rows = []
    for row in np.flatnonzero(straight[:-1] & ~straight[1:]) + 1:
        # The second before is too short at the start of a drive and after a gap.
        before = (time_s >= time_s[row] - SECOND_S) & (time_s < time_s[row])
        complete = before.sum() >= MIN_FRAMES * SECOND_S / step_s
        end = min(np.searchsorted(distance_m, distance_m[row] + REACH_M), len(distance_m) - 1)
        turn_rad = abs(heading_rad[end] - heading_rad[row])
        if complete and straight[before].all() and turn_rad >= TURN_RAD:
            rows.append(row)
    return np.array(rows, np.int64)


def read_onsets(drive: LabelledDrive) -> np.ndarray:
    """Return whether a turn begins at each frame of a drive, bool [G], by its labels."""
    with store.DriveReader(drive.labels, stage="labels") as file:
        rows = onsets(file.time_s, file["curvature_1pm"], label.read_labels(file))
        return np.isin(drive.frame, file.frame[rows])


def path(
    steering_rad: np.ndarray, speed_mps: np.ndarray, time_s: np.ndarray, wheelbase_m: float
) -> np.ndarray:
    """Return the car's positions [F,2] in metres, x ahead and y to the left of its start: ψ ← ψ +
    v/L tan Θ dt.

    The paper's formula as printed, [x, y] ← [x, y] + v dt [cos Θ, sin Θ], takes the steering angle
    as the heading. The speed and angle of a frame describe the step that ends there: in KITTI, the
    rates in oxts lag half a step behind the poses. So paths of true angles stay within 1 m per 100
    m of the recorded track in 23 of 30 drives; with rates that apply until the next frame, in 12
    (tests/pipeline/evaluate/test_evaluate.py).
    """
    dt_s = np.diff(time_s)
    speed_mps = speed_mps[1:]
    turned_rad = speed_mps / wheelbase_m * np.tan(steering_rad[1:]) * dt_s
    # Halfway through the step, the heading is the direction of the arc's chord.
    heading_rad = np.cumsum(turned_rad) - turned_rad / 2
    direction = np.stack([np.cos(heading_rad), np.sin(heading_rad)], axis=-1)
    steps_m = (speed_mps * dt_s)[:, None] * direction
    return np.concatenate([np.zeros((1, 2)), np.cumsum(steps_m, axis=0)])


def segments(onset: np.ndarray, predicted_rad: np.ndarray) -> list[np.ndarray]:
    """Return the rows between restarts, which have predictions [F]; `onset` bool [F]: a turn
    begins.
    """
    rows = np.flatnonzero(~np.isnan(predicted_rad))
    restarts = np.flatnonzero((np.diff(rows) > 1) | onset[rows[1:]]) + 1
    return [segment for segment in np.split(rows, restarts) if len(segment) > 1]


def drift(drives: Iterable[tuple[LabelledDrive, np.ndarray, np.ndarray]]) -> float | None:
    """Return the distance in metres between predicted and true end of a segment, per 100 m (the
    paper's Figure 5).

    Each drive comes with its onsets, bool [G], and predicted angles [G]; speed and time are
    measured. At an onset of a turn, and after frames without a prediction, the predicted path
    restarts at the true one. None without segments.
    """
    error_m = 0.0
    distance_m = 0.0
    for drive, onset, predicted_rad in drives:
        wheelbase_m = drive.settings["labels"]["wheelbase_m"]
        for rows in segments(onset, predicted_rad):
            speed_mps = drive.driven.speed_mps[rows]
            time_s = drive.time_s[rows]
            true = path(drive.driven.steering_rad[rows], speed_mps, time_s, wheelbase_m)
            predicted = path(predicted_rad[rows], speed_mps, time_s, wheelbase_m)
            error_m += float(np.linalg.norm(predicted[-1] - true[-1]))
            distance_m += float(np.linalg.norm(np.diff(true, axis=0), axis=1).sum())
    return 100 * error_m / distance_m if distance_m else None
