"""Draw roads: turns at crossings, bends, straights past side roads; and the side roads of junctions."""

from dataclasses import replace

import numpy as np

from pipeline.sample.route import BEHIND_M, STEP_M, Arm, Piece, Route, bend, trace, unit

DECK = ("right", "bend+", "crossing", "left", "sweep-", "corner+", "bend-", "sweep+", "corner-")
"""Manoeuvres, shuffled for every road: right and left turns at crossings, corners of wider roads, bends, long sweeps
(+ left, - right), and straight on past side roads."""
_APART_M, _ROOM_M = 60.0, 32.0  # stretches farther apart along the road keep this distance
_ARM_M, _ARM_HALF_M = (28.0, 45.0), (2.6, 4.2)  # length and half the width of side roads


def draw_route(rng: np.random.Generator, length_m: float, lane_m: float, first: str = "crossing") -> Route:
    """Draw a road of at least `length_m` after the first frame that does not cross itself.

    It begins with the manoeuvre `first` of :data:`DECK`, often in the middle of it: otherwise all short drives would
    begin with a straight.
    """
    while True:
        route = _draw(rng, length_m, lane_m, first)
        if _clear_of_itself(route):
            return route


def _draw(rng: np.random.Generator, length_m: float, lane_m: float, first: str) -> Route:
    pieces: list[Piece] = [(2 * BEHIND_M, 0.0, 0.0)]
    begun: list[tuple[str, float, float]] = []  # kind, s of its start and end

    def total() -> float:
        return sum(piece[0] for piece in pieces)

    while total() < 2 * BEHIND_M + length_m:
        cards = [str(card) for card in rng.permutation(DECK)]
        for card in cards if begun else [first, *(card for card in cards if card != first)]:
            start = total()
            pieces += _manoeuvre(card, lane_m, rng)
            begun.append((card.rstrip("+-"), start, total()))
            pieces.append((rng.uniform(4, 20), 0.0, 0.0))
    # The first frame lies some metres before the first manoeuvre, or in it.
    (_, start, end), *_ = begun
    origin = round(rng.uniform(start - 12.0, start + 0.6 * (end - start)) / STEP_M) * STEP_M
    s, xy, heading, curvature = (part[round((origin - BEHIND_M) / STEP_M) :] for part in trace(pieces))
    s = s - origin
    stop = int(np.searchsorted(s, length_m))
    route = Route(s[:stop], xy[:stop], heading[:stop], curvature[:stop], lane_m, (), ())
    junctions, arms = [], []
    for kind, start, end in ((kind, start - origin, end - origin) for kind, start, end in begun):
        if kind in ("bend", "sweep") or end > s[stop - 1]:
            continue
        ways = _crossing_arms(route, start, end, rng) if kind == "crossing" else _turn_arms(route, start, end, rng)
        arms += ways
        junctions += [(start + end) / 2] * bool(ways)
    return replace(route, junctions_m=tuple(junctions), arms=tuple(arms))


def _manoeuvre(card: str, lane_m: float, rng: np.random.Generator) -> list[Piece]:
    """Draw the pieces of a card of the deck; radii are those of the rear axle."""
    kind, side = card.rstrip("+-"), -1 if card.endswith("-") else 1
    if kind == "right":
        return bend(-np.deg2rad(rng.uniform(75, 100)), rng.uniform(5.0, 7.0), rng.uniform(4, 6))
    if kind == "left":  # across the other lane
        return bend(np.deg2rad(rng.uniform(75, 100)), 0.6 * lane_m + rng.uniform(4.7, 8.0), rng.uniform(5, 8))
    if kind == "corner":
        return bend(side * np.deg2rad(rng.uniform(75, 100)), rng.uniform(9, 14), rng.uniform(7, 10))
    if kind == "bend":
        return bend(side * np.deg2rad(rng.uniform(35, 75)), rng.uniform(12, 30), rng.uniform(7, 11))
    if kind == "sweep":
        return bend(side * np.deg2rad(rng.uniform(12, 30)), rng.uniform(40, 200), rng.uniform(10, 15))
    return [(rng.uniform(16, 22), 0.0, 0.0)]


def _clear_of_itself(route: Route) -> bool:
    """Return whether no two stretches of road are close and no arm reaches another stretch."""
    every = int(1 / STEP_M)
    s, xy = route.s_m[::every], route.xy[::every]
    far = np.abs(s[:, None] - s[None]) > _APART_M
    if (np.linalg.norm(xy[:, None] - xy[None], axis=-1)[far] < _ROOM_M).any():
        return False
    return all(_arm_is_clear(arm, xy) for arm in route.arms)


def _crossing_arms(route: Route, start: float, end: float, rng: np.random.Generator) -> list[Arm]:
    """Draw open side roads on one or both sides where the ego goes straight on from s = `start` to `end`."""
    first, heading_in = route.at(start, route.centre_m)
    last, _ = route.at(end, route.centre_m)
    length, half = rng.uniform(*_ARM_M), rng.uniform(*_ARM_HALF_M)
    square = heading_in + np.pi / 2 + np.deg2rad(rng.uniform(-10, 10))
    sides = [[0.0], [np.pi], [0.0, np.pi]][rng.integers(3)]
    return [Arm((first + last) / 2, float(square + turn), False, length, half) for turn in sides]


def _turn_arms(route: Route, start: float, end: float, rng: np.random.Generator) -> list[Arm]:
    """Draw the other roads of a junction where the ego turns from s = `start` to `end`.

    They are closed: otherwise the image would not show which way the ego goes.
    """
    first, heading_in = route.at(start, route.centre_m)
    last, heading_out = route.at(end, route.centre_m)
    length, half = rng.uniform(*_ARM_M), rng.uniform(*_ARM_HALF_M)
    # The roads' centre lines intersect at the junction.
    into, out = unit(heading_in), unit(heading_out)
    along = np.linalg.solve(np.stack([into, -out], axis=1), last - first)[0]
    middle = first + along * into
    which = rng.integers(4)  # corner | T-junction, entered from its stem | straight on | both
    headings = [float(heading_out + np.pi)] * (which in (1, 3)) + [float(heading_in)] * (which in (2, 3))
    return [Arm(middle, heading, True, length, half) for heading in headings]


def _arm_is_clear(arm: Arm, xy: np.ndarray) -> bool:
    """Return whether the path xy [N,2] stays away from the arm beyond its mouth."""
    along = np.arange(14, arm.length_m)[:, None]
    points = arm.xy + along * unit(arm.heading_rad)
    return not (np.linalg.norm(points[:, None] - xy[None], axis=-1) < 8).any()
