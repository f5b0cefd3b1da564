"""PointNet++'s sampling and grouping (paper eq. 1; Qi et al. 2017): farthest points, and who is in their balls."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

Size = tuple[int, float, int]
"""Centres, radius in metres, neighbours per centre."""


@dataclass(frozen=True)
class Level:
    """One set abstraction's sampling and grouping of P points.

    centres: int64 [M], the points chosen.
    neighbours: int64 [M,n], the points in the ball around each centre.
    """

    centres: np.ndarray
    neighbours: np.ndarray


def levels(xyz: np.ndarray, sizes: Iterable[Size], rng: np.random.Generator) -> list[Level]:
    """Sample and group the points [P,3], then the centres that this leaves, and so on: a level for each of `sizes`."""
    made = []
    # Points are stored along a curve through space, so the first of a ball would be one corner of it. The reference
    # has no such order, and takes a random part of a crowded ball; so does this. Later levels are in the order in
    # which they were chosen, farthest first, of which any beginning is evenly spread.
    order = rng.permutation(len(xyz))
    for count, radius_m, neighbours in sizes:
        centres = farthest_points(xyz, count)
        made.append(Level(centres, ball_query(xyz, centres, radius_m, neighbours, order)))
        xyz = xyz[centres]
        order = np.arange(len(xyz))
    return made


def farthest_points(xyz: np.ndarray, count: int) -> np.ndarray:
    """Choose points one after the other, each the farthest from those before; the first point [P,3] is the first.

    Returns: indices int64 [min(count, P)], in the order of choice. Of equally far points the first is taken.
    """
    axes = _axes(xyz)
    chosen = np.zeros(min(count, len(xyz)), np.int64)
    nearest = np.full(len(xyz), np.inf)  # squared distance to the nearest chosen point
    for step in range(1, len(chosen)):
        np.minimum(nearest, _squared_distances(axes, chosen[step - 1]), out=nearest)
        chosen[step] = nearest.argmax()
    return chosen


def ball_query(
    xyz: np.ndarray, centres: np.ndarray, radius_m: float, neighbours: int, order: np.ndarray | None = None
) -> np.ndarray:
    """Return the first `neighbours` points of the ball of `radius_m` around each centre.

    Args:
        xyz: [P,3] metres.
        centres: int [M], which of the points.
        order: permutation [P] that says what "first" means; None is that of the points.
    Returns:
        int64 [M,neighbours]. In a ball that holds fewer, the first is repeated, as in the reference: a maximum over
        the neighbours does not notice.
    """
    order = np.arange(len(xyz)) if order is None else order
    place = np.argsort(order)
    axes = _axes(xyz[order])
    members = np.empty((len(centres), neighbours), np.int64)
    for row, centre in enumerate(place[centres]):
        ball = np.flatnonzero(_squared_distances(axes, centre) <= radius_m**2)[:neighbours]
        members[row] = ball[0]  # a centre is in its own ball
        members[row, : len(ball)] = ball
    return order[members]


def _axes(xyz: np.ndarray) -> Sequence[np.ndarray]:
    """Return x, y and z, contiguous: four times as fast as rows of three.

    In float64, squared distances between coordinates in steps of 1/1024 m (as clouds are stored) are exact.
    """
    return [np.ascontiguousarray(axis, np.float64) for axis in xyz.T]


def _squared_distances(axes: Sequence[np.ndarray], centre: int) -> np.ndarray:
    total = np.zeros(len(axes[0]))
    for axis in axes:
        difference = axis - axis[centre]
        difference *= difference
        total += difference
    return total
