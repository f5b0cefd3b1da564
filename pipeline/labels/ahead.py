"""Compute the mean curvature of the path ahead in ranges of distance.

The path ahead of a frame is the one that the car drives afterwards.
"""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from pipeline.labels.label import REVERSING_MPS
from pipeline.labels.label_file import Labels

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

    The curvature of a range is the change of heading between its two edges, divided by the arc
    length between them. Heading and arc length are integrals of yaw rate and speed by the
    trapezoidal rule, and are linear between frames.

    A curvature is valid under three conditions, which hold from the frame to the far edge: all
    frames exist and have a known speed and yaw rate, the car never reverses, and it stands for at
    most `max_stand_s`.

    Args:
        frame: frame numbers [F].
        time_s: times [F] of these frames.
        labels: labels of these frames, whose speeds and yaw rates are used.
        edges_m: ascending edges [R+1] of the ranges, in metres along the path.
        max_stand_s: longest time for which the car may stand.

    Returns:
        The curvatures in 1/m, float64 [F,R], left positive, and whether they are valid, bool [F,R].
        A curvature that is not valid is 0.
    """
    curvature = np.zeros((len(frame), len(edges_m) - 1))
    valid = np.zeros(curvature.shape, bool)
    measured = np.isfinite(labels.speed_mps) & np.isfinite(labels.yaw_rate_radps)
    is_forward = measured & (labels.speed_mps >= REVERSING_MPS)

    # Cut the drive at missing frames, and before and after each frame that does not go forward. A
    # drive without frames is one empty part.
    gaps = (np.diff(frame) != 1) | ~is_forward[1:] | ~is_forward[:-1]
    starts = np.flatnonzero(gaps) + 1
    for first, end in pairwise([0, *starts, len(frame)]):
        rows = slice(first, end)
        if first < end and is_forward[rows].all():
            curvature[rows], valid[rows] = _drive_part(
                time_s[rows], labels.select_rows(rows), np.array(edges_m), max_stand_s
            )
    return np.where(valid, curvature, 0.0), valid


def _drive_part(
    time_s: np.ndarray, labels: Labels, edges_m: np.ndarray, max_stand_s: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return the curvatures and their validity as :func:`path_ahead` does.

    The frames are consecutive and go forward. A curvature is not valid if they end before the far
    edge.
    """
    # A speed below 0 is noise of a standing car. It counts as 0, so that arc length never
    # decreases.
    speed_mps = np.maximum(labels.speed_mps, 0.0)
    arc_m = _integrate_rate(speed_mps, time_s)

    # A car that does not move does not turn.
    turned_rad = np.diff(_integrate_rate(labels.yaw_rate_radps, time_s))
    turned_rad = np.where(np.diff(arc_m) > 0, turned_rad, 0.0)
    heading_rad = np.concatenate([[0.0], np.cumsum(turned_rad)])

    edge_arc_m = arc_m[:, None] + edges_m  # [F,R+1]
    edge_heading_rad = np.interp(edge_arc_m, arc_m, heading_rad)
    curvature = np.diff(edge_heading_rad, axis=1) / np.diff(edges_m)

    # The time for which the car stands before it reaches the far edge is the difference of two
    # times since the first frame.
    far_arc_m = edge_arc_m[:, 1:]
    stood_s = _integrate_rate((speed_mps < STANDING_MPS).astype(float), time_s)
    stands_s = np.interp(far_arc_m, arc_m, stood_s) - stood_s[:, None]
    return curvature, (far_arc_m <= arc_m[-1]) & (stands_s <= max_stand_s)


def _integrate_rate(values: np.ndarray, time_s: np.ndarray) -> np.ndarray:
    """Return the integral of `values` [F] from the first frame to each, by the trapezoidal rule.

    SciPy has such a function, too, but importing SciPy takes a second.
    """
    trapezoids = (values[1:] + values[:-1]) / 2 * np.diff(time_s)
    return np.concatenate([[0.0], np.cumsum(trapezoids)])
