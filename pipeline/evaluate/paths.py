"""Integrate predicted steering into paths and measure their drift (the paper's Figure 5).

Speed and time are measured, the steering angle is predicted. At an onset of a turn (decisions.py), and after frames
without a prediction, the predicted path restarts at the true one.

The speed and angle of a frame describe the step that ends there: in KITTI, the rates in oxts lag half a step behind the
poses. With this convention, paths of true angles stay within 1 m per 100 m of the recorded track in 23 of 30 drives;
with rates that apply until the next frame, in 12 (tests/pipeline/evaluate/test_paths.py).
"""

from collections.abc import Iterable
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from pipeline.labels import label


class Track(NamedTuple):
    """Measured motion of a drive, F frames; angles in rad, left +."""

    time_s: np.ndarray
    speed_mps: np.ndarray
    steering_rad: np.ndarray  # recorded
    onsets: np.ndarray  # rows at which a turn begins
    wheelbase_m: float

    def path(self, steering_rad: np.ndarray, first: int, last: int) -> np.ndarray:
        """Return the positions [last - first, 2] in metres for steering angles [F], from the pose at row `first`."""
        # label.path applies a frame's values to the step after it; rolled, they apply to the step before it.
        angle, speed = (np.roll(values[first:last], -1) for values in (steering_rad, self.speed_mps))
        return label.path(angle, speed, self.time_s[first:last], self.wheelbase_m)


def segments(track: Track, predicted_rad: np.ndarray) -> list[tuple[int, int]]:
    """Return the rows [first, last) between restarts; every row has a prediction."""
    predicted = ~np.isnan(predicted_rad)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], predicted, [False]]).astype(np.int8)))
    parts = []
    for first, last in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        inside = [row for row in track.onsets.tolist() if first < row < last]
        parts += [(a, b) for a, b in pairwise([first, *inside, last]) if b - a > 1]
    return parts


def drift(tracks: Iterable[tuple[Track, np.ndarray]]) -> float | None:
    """Return the distance in metres between predicted and true end of a segment, per 100 m driven.

    Each track comes with predicted angles [F]. None without segments.
    """
    error_m = distance_m = 0.0
    for track, predicted_rad in tracks:
        for first, last in segments(track, predicted_rad):
            true, predicted = (track.path(angle, first, last) for angle in (track.steering_rad, predicted_rad))
            error_m += float(np.linalg.norm(predicted[-1] - true[-1]))
            distance_m += float(np.linalg.norm(np.diff(true, axis=0), axis=1).sum())
    return 100 * error_m / distance_m if distance_m else None
