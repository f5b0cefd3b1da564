"""Compute the path of predicted angles, and its drift from the labelled path."""

import numpy as np
import pandas as pd

from pipeline.labels.label import Car


def integrate_path(
    steering_rad: np.ndarray, speed_mps: np.ndarray, time_s: np.ndarray, wheelbase_m: float
) -> np.ndarray:
    """Return the car's positions [F,2] in metres, x ahead and y to the left of its start.

    The heading follows from the bicycle model, ψ ← ψ + v/L tan Θ dt. The paper's formula as
    printed, [x, y] ← [x, y] + v dt [cos Θ, sin Θ], takes the steering angle as the heading.

    The speed and angle of a frame are applied to the step that ends at the frame, since the rates
    in KITTI's oxts lag half a step behind its poses. In this way, paths of true angles stay within
    1 m per 100 m of the recorded track in 23 of 30 drives. If the rates are applied to the step
    that begins at the frame, they do so in 12 drives (tests/pipeline/evaluate/test_drift.py).
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


def find_ways(drive: np.ndarray, frame: np.ndarray, known: np.ndarray) -> list[np.ndarray]:
    """Return the rows of each way: consecutive frames of a drive that are known.

    `drive` [N] is the number of each frame's drive, `frame` [N] its number in the drive, and
    `known`, bool [N], tells whether it has a label, a prediction and a speed. Ways of a single
    frame are left out.
    """
    rows = np.flatnonzero(known)
    # Frames that the drive lacks have no row, so the rows beside them are consecutive.
    ends = (np.diff(frame[rows]) != 1) | (np.diff(drive[rows]) != 0)
    pieces = np.split(rows, np.flatnonzero(ends) + 1)
    return [way for way in pieces if len(way) > 1]


def measure_drift(
    true_rad: np.ndarray,
    predicted_rad: np.ndarray,
    drive: np.ndarray,
    frames: pd.DataFrame,
    car: Car,
) -> float | None:
    """Return the drift of predicted angles in metres per 100 m (the paper's Figure 5).

    It is the distance between the predicted and the labelled path at the end of each way, over the
    length of all ways. Both paths start at the same point and have the same measured speeds and
    times. The result is None if there is no way.

    Args:
        true_rad: labelled angles [N], NaN in frames that do not count.
        predicted_rad: predicted angles [N].
        drive: number [N] of each frame's drive.
        frames: the frames [N], with columns frame, time_s and speed_mps, NaN if unknown.
        car: the car of the labels.
    """
    error_m = 0.0
    length_m = 0.0
    speed_mps = frames["speed_mps"].to_numpy()
    # A recorded angle is a label also where the speed is unknown, but such a frame has no path.
    known = np.isfinite(true_rad) & np.isfinite(predicted_rad) & np.isfinite(speed_mps)
    for rows in find_ways(drive, frames["frame"].to_numpy(), known):
        way_mps = speed_mps[rows]
        time_s = frames["time_s"].to_numpy()[rows]
        true = integrate_path(true_rad[rows], way_mps, time_s, car.wheelbase_m)
        predicted = integrate_path(predicted_rad[rows], way_mps, time_s, car.wheelbase_m)
        error_m += float(np.linalg.norm(predicted[-1] - true[-1]))
        length_m += float(np.linalg.norm(np.diff(true, axis=0), axis=1).sum())
    return 100 * error_m / length_m if length_m else None
