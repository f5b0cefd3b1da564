"""Sampling and grouping of PointNet++ (paper eq. 1; Qi et al. 2017): farthest point sampling and ball query."""

from collections.abc import Iterable, Sequence

import numpy as np

LevelSize = tuple[int, float, int]
"""Centres, radius in metres, neighbours per centre."""


Grouping = tuple[np.ndarray, np.ndarray]
"""Centres int64 [M], the sampled points, and neighbours int64 [M,n], the points in the ball around each centre."""


def levels(xyz: np.ndarray, sizes: Iterable[LevelSize], rng: np.random.Generator) -> list[Grouping]:
    """Sample and group the points [P,3], then the resulting centres, and so on: a set abstraction for each size."""
    result = []
    # Points are stored in Morton order, so the first points of a ball would be one corner of it. In the reference the
    # order is random, hence the permutation. Later levels are in the order of farthest point sampling, in which the
    # first points are evenly spread.
    order = rng.permutation(len(xyz))
    for count, radius_m, neighbours in sizes:
        centres = farthest_points(xyz, count)
        result.append((centres, ball_query(xyz, centres, radius_m, neighbours, order)))
        xyz = xyz[centres]
        order = np.arange(len(xyz))
    return result


def farthest_points(xyz: np.ndarray, count: int) -> np.ndarray:
    """Sample points [P,3] iteratively, each the farthest from the previous ones, starting with the first point.

    Returns: indices int64 [min(count, P)] in sampling order. Ties take the first point.
    """
    axes = _axes(xyz)
    sampled = np.zeros(min(count, len(xyz)), np.int64)
    nearest = np.full(len(xyz), np.inf)  # squared distance to the nearest sample
    for step in range(1, len(sampled)):
        np.minimum(nearest, _squared_distances(axes, sampled[step - 1]), out=nearest)
        sampled[step] = nearest.argmax()
    return sampled


def ball_query(
    xyz: np.ndarray, centres: np.ndarray, radius_m: float, neighbours: int, order: np.ndarray | None = None
) -> np.ndarray:
    """Return the first `neighbours` points of the ball around each centre, int64 [M,neighbours].

    `centres` [M] are rows of the points xyz [P,3]; `order` [P] is a permutation in which points are searched. Balls
    with fewer points repeat the first, as in the reference; a maximum over the neighbours is not affected.
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
    """Return x, y and z as contiguous float64 arrays: four times faster than rows of three.

    Squared distances between stored coordinates, multiples of 1/1024 m, are exact in float64.
    """
    return [np.ascontiguousarray(axis, np.float64) for axis in xyz.T]


def _squared_distances(axes: Sequence[np.ndarray], centre: int) -> np.ndarray:
    total = np.zeros(len(axes[0]))
    for axis in axes:
        difference = axis - axis[centre]
        difference *= difference
        total += difference
    return total
