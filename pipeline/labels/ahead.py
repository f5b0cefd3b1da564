"""Compute the path ahead: its mean curvature in ranges of distance.

It follows from the motion that the car drives afterwards.
"""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from pipeline.labels.label import REVERSING_MPS, Labels

# Speed in m/s below which the car stands. At standstill, KITTI's measured speed reaches 0.15.
STANDING_MPS = 0.2


def path_ahead(
    frame: np.ndarray,
    time_s: np.ndarray,
    labels: Labels,
    edges_m: Sequence[float],
    max_stand_s: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the mean curvature of the driven path in ranges of distance ahead of each frame.

    Distances are along the path. Curvature is float64 [F,R] in 1/m, left positive, 0 where it is
    not valid, bool [F,R]: the change of heading between two edges, divided by the arc length
    between them. Heading and arc length are integrals of yaw rate and speed (trapezoidal rule), and
    linear between frames. A value is valid if, from the frame to the far edge, all frames exist and
    are measured, and the car never reverses and stands for at most `max_stand_s`. `frame` and
    `time_s` are those of the frames [F], `edges_m` R+1 ascending distances.
    """
    curvature = np.zeros((len(frame), len(edges_m) - 1))
    valid = np.zeros(curvature.shape, bool)
    measured = np.isfinite(labels.speed_mps) & np.isfinite(labels.yaw_rate_radps)
    usable = measured & (labels.speed_mps >= REVERSING_MPS)

    # Between the gaps, frames are consecutive; a frame that is not usable is alone.
    gaps = (np.diff(frame) != 1) | ~usable[1:] | ~usable[:-1]
    starts = np.flatnonzero(gaps) + 1
    for first, end in pairwise([0, *starts, len(frame)]):
        rows = slice(first, end)
        if first < end and usable[rows].all():
            curvature[rows], valid[rows] = _without_gap(
                time_s[rows], labels.at(rows), np.array(edges_m), max_stand_s
            )
    return np.where(valid, curvature, 0.0), valid


def _without_gap(
    time_s: np.ndarray, labels: Labels, edges_m: np.ndarray, max_stand_s: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return :func:`path_ahead` of consecutive, measured frames.

    It is not valid where they end before the far edge.
    """
    # A speed below 0 is noise at standstill, and arc length never decreases.
    speed_mps = np.maximum(labels.speed_mps, 0.0)
    arc_m = _integral(speed_mps, time_s)

    # A car that does not move does not turn.
    turned_rad = np.diff(_integral(labels.yaw_rate_radps, time_s))
    turned_rad = np.where(np.diff(arc_m) > 0, turned_rad, 0.0)
    heading_rad = np.concatenate([[0.0], np.cumsum(turned_rad)])

    edge_arc_m = arc_m[:, None] + edges_m  # [F,R+1]
    edge_heading_rad = np.interp(edge_arc_m, arc_m, heading_rad)
    curvature = np.diff(edge_heading_rad, axis=1) / np.diff(edges_m)

    # Time for which the car stands before it reaches the far edge.
    far_arc_m = edge_arc_m[:, 1:]
    stood_s = _integral((speed_mps < STANDING_MPS).astype(float), time_s)
    stands_s = np.interp(far_arc_m, arc_m, stood_s) - stood_s[:, None]
    return curvature, (far_arc_m <= arc_m[-1]) & (stands_s <= max_stand_s)


def _integral(values: np.ndarray, time_s: np.ndarray) -> np.ndarray:
    """Return the integral of `values` [F] from the first frame to each, by the trapezoidal rule.

    SciPy has it, too, but importing that takes a second.
    """
    trapezoids = (values[1:] + values[:-1]) / 2 * np.diff(time_s)
    return np.concatenate([[0.0], np.cumsum(trapezoids)])
