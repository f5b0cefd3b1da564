"""Side roads at junctions, and places where a recorded route meets itself."""

from dataclasses import dataclass

import numpy as np

from pipeline.town.route import STEP_M, Arm, Route, unit

_LENGTH_M, _HALF_M = (28.0, 45.0), (2.6, 4.2)
_APART_M = 60.0  # along the route; nearer points belong to the same stretch
_NOWHERE_M = 1000.0
_MOUTH_M, _MOUTH_RAD = 9.0, np.deg2rad(30)


def crossing_arms(route: Route, start: float, end: float, rng: np.random.Generator) -> list[Arm]:
    """Draw open side roads on one or both sides where the ego goes straight on from s = `start` to `end`."""
    first, heading_in = route.at(start, route.centre_m)
    last, _ = route.at(end, route.centre_m)
    length, half = rng.uniform(*_LENGTH_M), rng.uniform(*_HALF_M)
    square = heading_in + np.pi / 2 + np.deg2rad(rng.uniform(-10, 10))
    sides = [[0.0], [np.pi], [0.0, np.pi]][rng.integers(3)]
    return [Arm((first + last) / 2, float(square + turn), False, length, half) for turn in sides]


def turn_arms(route: Route, start: float, end: float, rng: np.random.Generator) -> list[Arm]:
    """Draw the other roads of a junction where the ego turns from s = `start` to `end`.

    They are closed: otherwise the image would not show which way the ego goes.
    """
    first, heading_in = route.at(start, route.centre_m)
    last, heading_out = route.at(end, route.centre_m)
    length, half = rng.uniform(*_LENGTH_M), rng.uniform(*_HALF_M)
    # The roads' centre lines intersect at the junction.
    into, out = unit(heading_in), unit(heading_out)
    along = np.linalg.solve(np.stack([into, -out], axis=1), last - first)[0]
    middle = first + along * into
    which = rng.integers(4)  # corner | T-junction, entered from its stem | straight on | both
    headings = [float(heading_out + np.pi)] * (which in (1, 3)) + [float(heading_in)] * (which in (2, 3))
    return [Arm(middle, heading, True, length, half) for heading in headings]


def arm_is_clear(arm: Arm, xy: np.ndarray) -> bool:
    """Return whether the path xy [N,2] stays away from the arm beyond its mouth."""
    along = np.arange(14, arm.length_m)[:, None]
    points = arm.xy + along * unit(arm.heading_rad)
    return not (np.linalg.norm(points[:, None] - xy[None], axis=-1) < 8).any()


@dataclass(frozen=True)
class Meetings:
    """Per sample of the route: distances to the nearest other and the nearest earlier stretch [N], and whether it lies
    at a junction of two stretches, bool [N]."""

    other_m: np.ndarray
    earlier_m: np.ndarray
    junction: np.ndarray


def find_meetings(route: Route) -> Meetings:
    """Compare each metre of a route with all others: recorded drives cross their track and repeat streets."""
    every = round(1 / STEP_M)
    s, xy, heading = route.s_m[::every], route.xy[::every], route.heading_rad[::every]
    meetings = np.zeros((3, len(s)))
    for i in range(len(s)):
        to = np.linalg.norm(xy - xy[i], axis=1)
        to[np.abs(s - s[i]) <= _APART_M] = _NOWHERE_M
        across = np.abs(np.sin(heading - heading[i])) > np.sin(_MOUTH_RAD)
        meetings[:, i] = to.min(), to[: i + 1].min(), (across & (to < _MOUTH_M)).any()
    other, earlier, junction = (np.interp(route.s_m, s, row) for row in meetings)
    return Meetings(other, earlier, junction > 0)
