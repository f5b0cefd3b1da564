"""Find the onsets of turns, and compute the drift of predicted paths.

At an onset, the driver chooses a way that the scene does not determine. An onset is a frame at
which |curvature| reaches STRAIGHT_1PM after one second below it, if the car turns by at least
TURN_RAD within the next REACH_M metres. So it is the beginning of a turn at a street corner, and
not of a bend of the road or of a manoeuvre around an obstacle. On KITTI's drives, this rule finds
turns of 70° to 100°. It uses only the motion of the labels. In a frame whose label is invalid, for
instance while the car waits at a corner, the curvature of the last valid frame is used.
"""

from collections.abc import Iterable

import numpy as np

from pipeline.base import store
from pipeline.labels import label
from pipeline.train.targets import LabelledDrive

# Curvature in 1/m below which a road is straight. It is a radius of 67 m. A car that keeps its lane
# stays below it.
STRAIGHT_1PM = 0.015
# Least change of heading in rad within REACH_M.
TURN_RAD = np.pi / 4
# Length in metres of the way within which the car turns.
REACH_M = 25.0
# Time in seconds of the straight stretch before a turn.
SECOND_S = 1.0
# Least share of this second's frames that the drive must have.
MIN_FRAMES = 0.75


def onsets(time_s: np.ndarray, curvature_1pm: np.ndarray, labels: label.Labels) -> np.ndarray:
    """Return the rows, int64, of the frames [F] of a drive at which a turn begins."""
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
    """Return whether a turn begins at each frame of a drive, bool [G], according to its labels."""
    with store.DriveReader(drive.labels, stage="labels") as file:
        rows = onsets(file.time_s, file["curvature_1pm"], label.read_labels(file))
        return np.isin(drive.frame, file.frame[rows])


def path(
    steering_rad: np.ndarray, speed_mps: np.ndarray, time_s: np.ndarray, wheelbase_m: float
) -> np.ndarray:
    """Return the car's positions [F,2] in metres, x ahead and y to the left of its start.

    The heading follows from the bicycle model, ψ ← ψ + v/L tan Θ dt. The paper's formula as
    printed, [x, y] ← [x, y] + v dt [cos Θ, sin Θ], takes the steering angle as the heading.

    The speed and angle of a frame are applied to the step that ends at the frame, since the rates
    in KITTI's oxts lag half a step behind its poses. In this way, paths of true angles stay within
    1 m per 100 m of the recorded track in 23 of 30 drives. If the rates are applied to the step
    that begins at the frame, they do so in 12 drives (tests/pipeline/evaluate/test_evaluate.py).
    """
    dt_s = np.diff(time_s)
    speed_mps = speed_mps[1:]
    turned_rad = speed_mps / wheelbase_m * np.tan(steering_rad[1:]) * dt_s
    # The car moves along the chord of an arc, whose direction is the heading halfway through the
    # step.
    heading_rad = np.cumsum(turned_rad) - turned_rad / 2
    direction = np.stack([np.cos(heading_rad), np.sin(heading_rad)], axis=-1)
    steps_m = (speed_mps * dt_s)[:, None] * direction
    return np.concatenate([np.zeros((1, 2)), np.cumsum(steps_m, axis=0)])


def segments(onset: np.ndarray, predicted_rad: np.ndarray) -> list[np.ndarray]:
    """Return the rows of each segment, a stretch of frames [F] with predictions and no restart.

    The predicted path restarts after frames without a prediction, and where a turn begins, which
    `onset`, bool [F], tells. Segments of a single frame are left out.
    """
    rows = np.flatnonzero(~np.isnan(predicted_rad))
    restarts = np.flatnonzero((np.diff(rows) > 1) | onset[rows[1:]]) + 1
    return [segment for segment in np.split(rows, restarts) if len(segment) > 1]


def drift(drives: Iterable[tuple[LabelledDrive, np.ndarray, np.ndarray]]) -> float | None:
    """Return the mean drift of predicted paths in metres per 100 m (the paper's Figure 5).

    The drift is the distance between the ends of the predicted and the true path of a segment. Both
    paths start at the same point and have the same measured speeds and times. The predicted path
    restarts at the true path where a turn begins, and after frames without a prediction. The result
    is None if there is no segment.

    `drives` are drives with their onsets, bool [G], and predicted angles [G].
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
