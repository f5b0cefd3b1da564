"""Compute the path ahead: its mean curvature in ranges of distance, from the motion that the car
drives afterwards.
"""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from pipeline.labels.label import REVERSING_MPS, Labels

STANDING_MPS = 0.2  # measured speed at standstill stays below: in KITTI it reaches 0.15 m/s


def path_ahead(
    frame: np.ndarray,
    time_s: np.ndarray,
    labels: Labels,
    edges_m: Sequence[float],
    max_stand_s: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the mean curvature of the driven path in ranges of distance ahead of each frame, along
    the path.

    Curvature is float64 [F,R] in 1/m, left positive, 0 where it is not valid, bool [F,R]: the
    change of heading between two edges, divided by the arc length between them. Heading and arc
    length are integrals of yaw rate and speed (trapezoidal rule), and linear between frames. A
    value is valid if, from the frame to the far edge, all frames exist and are measured, and the
    car never reverses and stands for at most `max_stand_s`. `frame`, `time_s`: of the frames [F];
    `edges_m`: R+1 ascending distances.
    """
    curvature = np.zeros((len(frame), len(edges_m) - 1))
    valid = np.zeros(curvature.shape, bool)
    usable = (
        np.isfinite(labels.speed_mps)
        & np.isfinite(labels.yaw_rate_radps)
        & (labels.speed_mps >= REVERSING_MPS)
    )
    broken = (np.diff(frame) != 1) | ~usable[1:] | ~usable[:-1]
    for first, last in pairwise([0, *(np.flatnonzero(broken) + 1), len(frame)]):
        rows = slice(first, last)
        if first < last and usable[rows].all():  # a frame that is not usable is alone
            curvature[rows], valid[rows] = _without_gap(
                time_s[rows], labels.at(rows), np.array(edges_m), max_stand_s
            )
    return np.where(valid, curvature, 0.0), valid


def _without_gap(
    time_s: np.ndarray, labels: Labels, edges_m: np.ndarray, max_stand_s: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return :func:`path_ahead` of consecutive, measured frames; not valid where they end before
    the far edge.
    """
    # below 0 it is noise at standstill, and arc length never decreases
    speed_mps = np.maximum(labels.speed_mps, 0.0)
    arc_m = _integral(speed_mps, time_s)
    turned = np.where(np.diff(arc_m) > 0, np.diff(_integral(labels.yaw_rate_radps, time_s)), 0.0)
    heading_rad = np.concatenate([[0.0], np.cumsum(turned)])
    stood_s = _integral((speed_mps < STANDING_MPS).astype(float), time_s)

    at_m = arc_m[:, None] + edges_m  # [F,R+1]
    curvature = np.diff(np.interp(at_m, arc_m, heading_rad), axis=1) / np.diff(edges_m)
    stands_s = np.interp(at_m[:, 1:], arc_m, stood_s) - stood_s[:, None]
    return curvature, (at_m[:, 1:] <= arc_m[-1]) & (stands_s <= max_stand_s)


# importing SciPy takes a second
def _integral(values: np.ndarray, time_s: np.ndarray) -> np.ndarray:
    """Return the integral of `values` [F] over time from the first frame to each, by the
    trapezoidal rule.
    """
    return np.concatenate([[0.0], np.cumsum((values[1:] + values[:-1]) / 2 * np.diff(time_s))])
