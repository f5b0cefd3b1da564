"""The roads that the ego does not take: side roads at crossings, and the other ways where it turns."""

import numpy as np

from pipeline.town.route import Arm, Route, unit

_LENGTH_M, _HALF_M = (28.0, 45.0), (2.6, 4.2)


def crossing_arms(route: Route, start: float, end: float, rng: np.random.Generator) -> list[Arm]:
    """Draw open side roads to the left, the right or both sides, where the ego goes straight on from s `start`."""
    first, heading_in = route.at(start, route.centre_m)
    last, _ = route.at(end, route.centre_m)
    length, half = rng.uniform(*_LENGTH_M), rng.uniform(*_HALF_M)
    square = heading_in + np.pi / 2 + np.deg2rad(rng.uniform(-10, 10))
    sides = [[0.0], [np.pi], [0.0, np.pi]][rng.integers(3)]
    return [Arm((first + last) / 2, float(square + turn), False, length, half) for turn in sides]


def turn_arms(route: Route, start: float, end: float, rng: np.random.Generator) -> list[Arm]:
    """Draw which of the ways that the ego does not take exist where it turns from s `start` to `end`.

    They are closed: where they were open, nobody could see beforehand which way the ego takes.
    """
    first, heading_in = route.at(start, route.centre_m)
    last, heading_out = route.at(end, route.centre_m)
    length, half = rng.uniform(*_LENGTH_M), rng.uniform(*_HALF_M)
    # The roads' middle lines meet at the junction.
    into, out = unit(heading_in), unit(heading_out)
    along = np.linalg.solve(np.stack([into, -out], axis=1), last - first)[0]
    middle = first + along * into
    which = rng.integers(4)  # a plain corner | a T, coming from its stem | straight on | both
    headings = [float(heading_out + np.pi)] * (which in (1, 3)) + [float(heading_in)] * (which in (2, 3))
    return [Arm(middle, heading, True, length, half) for heading in headings]


def arm_is_clear(arm: Arm, xy: np.ndarray) -> bool:
    """No point of the path xy [N,2] comes close to the arm beyond its mouth."""
    along = np.arange(14, arm.length_m)[:, None]
    points = arm.xy + along * unit(arm.heading_rad)
    return not (np.linalg.norm(points[:, None] - xy[None], axis=-1) < 8).any()
