"""The path ahead: the mean curvature of the way that the car drives afterwards, by range."""

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from pipeline.base.errors import InputError
from pipeline.base.store import DriveReader
from pipeline.train.quantity import Measure, Quantity


class Target(Quantity):
    """A column for each range of labels.ahead_m."""

    title = "path ahead"
    unit = "1/m"
    shown_title = "turn of the path ahead"
    shown_unit = "deg"
    shown_format = ".2f"
    measure = Measure(
        "displacement",
        "m",
        2,
        "The displacement is the mean distance between the predicted and the driven path after "
        "that length of path.",
    )
    is_ahead = True
    # The path at a junction is the driver's choice, and squared errors there would dominate.
    is_robust = True
    excluded_keys = ("horizon", "alpha")

    def __init__(self, labels: Mapping[str, Any], horizon: int = 0) -> None:
        super().__init__(labels, horizon)
        self.edges_m = list(labels.get("ahead_m", []))
        if not self.edges_m:
            fix = "Set it to edges such as [0, 10], and make the labels: dvc repro labels"
            raise InputError("predict: path needs labels.ahead_m (got [])", fix=fix)
        self.ranges = [f"{near:g}-{far:g} m" for near, far in pairwise(self.edges_m)]
        self.columns = [f"path_{near:g}-{far:g}m_1pm" for near, far in pairwise(self.edges_m)]

        # The end before the last leads: at the last one, errors are largest and least certain.
        self.ends = [f"at {far:g} m" for far in self.edges_m[1:]]
        self.lead = self.ends[-2:][0]

    def read(self, labels: DriveReader) -> np.ndarray:
        return np.where(labels["ahead_valid"], labels["ahead_1pm"], np.nan)

    def measured(self, angle_rad: np.ndarray) -> np.ndarray:
        curvature_1pm = np.tan(angle_rad) / self.car.wheelbase_m
        return np.repeat(curvature_1pm[:, None], len(self.columns), axis=1)

    def rescale(self, values: np.ndarray, factor: float) -> np.ndarray:
        """Return the path ahead [W,R] in a larger world.

        Each range of that world covers 1 / factor of its length in the world of the labels, where
        it overlaps one or several ranges. Curvature counts as constant within each of these. The
        result is unknown where one of these is unknown, or where the labels end.
        """
        edges_m = np.array(self.edges_m, np.float32)
        near = edges_m[:-1]
        far = edges_m[1:]

        # Share of each range of the labels (axis 1) in each range of the larger world (axis 0).
        starts = np.maximum(near[:, None] / factor, near)
        ends = np.minimum(far[:, None] / factor, far)
        share = np.maximum(ends - starts, 0) * factor / (far - near)[:, None]

        # Sum over the ranges of the labels, [W,R,R] → [W,R]. The shares of a range sum to 1, but
        # for rounding, if all of it is known.
        is_known = (share * np.isfinite(values)[:, None]).sum(axis=2) > 1 - 1e-4
        scaled = (share * np.nan_to_num(values)[:, None]).sum(axis=2) / factor
        return np.where(is_known, scaled, np.nan).astype(values.dtype)

    def rescale_measured(self, values: np.ndarray, factor: float) -> np.ndarray:
        return values / factor

    def shown(self, values: np.ndarray) -> np.ndarray:
        """Return the turn in all ranges together, in degrees."""
        return np.rad2deg((values * np.diff(self.edges_m)).sum(axis=-1))

    def errors(self, predicted: np.ndarray, truth: np.ndarray) -> np.ndarray:
        """Return the displacement at the far end of each range: the distance between both paths.

        A car that turns left on a radius of 10 m leaves a straight path:

        >>> labels = {"wheelbase_m": 2.7, "min_speed_mps": 1.0, "ahead_m": [0, 5, 10]}
        >>> straight_1pm = np.array([[0.0, 0.0]])
        >>> bend_1pm = np.array([[0.1, 0.1]])
        >>> Target(labels).errors(bend_1pm, straight_1pm).round(2).tolist()  # in metres
        [[1.24, 4.86]]
        """
        offset_m = end_points(predicted, self.edges_m) - end_points(truth, self.edges_m)
        return np.linalg.norm(offset_m, axis=-1)

    def curvature(self, values: np.ndarray) -> np.ndarray:
        return values


def end_points(curvature_1pm: np.ndarray, edges_m: Sequence[float]) -> np.ndarray:
    """Return the positions [..., R, 2] at the far end of each range of a path, in metres.

    The path begins at the near edge of the first range, at [0, 0], heading along the first axis;
    the second axis points to the left. Each range is an arc of its curvature [..., R]. `edges_m`
    has the edges [R+1] of the ranges. Positions beyond a range whose curvature is NaN are NaN.
    """
    length_m = np.diff(edges_m)
    turn_rad = curvature_1pm * length_m

    # The chord of an arc has the heading of its middle. np.sinc(x) is sin(πx) / (πx), and 1 at 0.
    chord_m = length_m * np.sinc(turn_rad / (2 * np.pi))
    heading_rad = np.cumsum(turn_rad, axis=-1) - turn_rad / 2
    chords = np.stack([chord_m * np.cos(heading_rad), chord_m * np.sin(heading_rad)], axis=-1)
    return np.cumsum(chords, axis=-2)
