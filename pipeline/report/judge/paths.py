"""Where the car would have gone, had it steered as a model predicts, beside where it went (the paper's Figure 5).

Measured are speed and time; steered is as predicted. Where the driver decides (decisions.py), and where predictions
begin anew, the predicted path starts again from the true one: what a model cannot know is no error.

A frame's speed and angle are those of the step that led to it: in KITTI, oxts' rates lag half a step behind its poses.
Taken so, paths of true angles stay within 1 m per 100 m of the recorded track in 23 of 30 drives; with rates that hold
until the next frame, in 12 (tests/pipeline/report/judge/test_paths.py).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np

from pipeline import label


@dataclass(frozen=True)
class Track:
    """What is known of a drive's F frames: angles in rad, left +."""

    time_s: np.ndarray
    speed_mps: np.ndarray
    steering_rad: np.ndarray  # recorded
    onsets: np.ndarray  # rows at which the driver decides
    wheelbase_m: float
    formula: Literal["bicycle", "paper"] = "bicycle"  # of label.path

    def path(self, steering_rad: np.ndarray, first: int, last: int) -> np.ndarray:
        """Return the positions [last - first, 2] in metres of steering so from where the car was at frame `first`.

        x is ahead, y to the left of where the drive starts.
        """
        own = self._path(steering_rad, slice(first, last))
        turned, start = self._heading()[first], self._path(self.steering_rad)[first]
        turn = np.array([[np.cos(turned), -np.sin(turned)], [np.sin(turned), np.cos(turned)]])
        return own @ turn.T + start

    def _path(self, steering_rad: np.ndarray, rows: slice = slice(None)) -> np.ndarray:
        # label.path holds what it is given of a frame until the next one: it is given what that one has.
        angle, speed = (np.roll(values[rows], -1) for values in (steering_rad, self.speed_mps))
        return label.path(angle, speed, self.time_s[rows], wheelbase_m=self.wheelbase_m, model=self.formula)

    def _heading(self) -> np.ndarray:
        if self.formula == "paper":  # every angle is a heading of its own: nothing adds up that a path could start with
            return np.zeros(len(self.time_s))
        rate = self.speed_mps[1:] / self.wheelbase_m * np.tan(self.steering_rad[1:])
        return np.concatenate([[0.0], np.cumsum(rate * np.diff(self.time_s))])


def segments(track: Track, predicted_rad: np.ndarray) -> list[tuple[int, int]]:
    """Return the frames [first, last) between resets in which every frame has a prediction."""
    has = ~np.isnan(predicted_rad)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], has, [False]]).astype(np.int8)))
    cut = []
    for first, last in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        inside = [row for row in track.onsets.tolist() if first < row < last]
        cut += [(a, b) for a, b in pairwise([first, *inside, last]) if b - a > 1]
    return cut


def drift(tracks: Sequence[tuple[Track, np.ndarray]]) -> float | None:
    """Return by how many metres predicted paths [F] are off at the end of a segment, per 100 m driven, if any were."""
    off_m = way_m = 0.0
    for track, predicted_rad in tracks:
        for first, last in segments(track, predicted_rad):
            true, own = (track.path(steering, first, last) for steering in (track.steering_rad, predicted_rad))
            off_m += float(np.linalg.norm(own[-1] - true[-1]))
            way_m += float(np.linalg.norm(np.diff(true, axis=0), axis=1).sum())
    return 100 * off_m / way_m if way_m else None
