"""The ego's path: straights and bends with clothoid transitions; turns at crossings and side roads.

World frame: x east, y north, z up, metres; headings counter-clockwise from east. It is the path of
the IMU (the rear axle): its curvature is continuous and piecewise linear in arc length, which makes
the steering label exact.
"""

from typing import NamedTuple

import numpy as np

STEP_M = 0.1
BEHIND_M = 40.0  # road behind the first frame, for the LiDAR
AHEAD_M = 110.0  # road ahead of the last frame, for the camera
IMU_HEIGHT_M = 0.93  # of the IMU over the road
# offset of the IMU from the car's centre line, as in KITTI; the car is centred in its lane
IMU_LEFT_M = 0.3

DECK = ("right", "bend+", "crossing", "left", "sweep-", "corner+", "bend-", "sweep+", "corner-")
"""Manoeuvres, shuffled for every road: right and left turns at crossings, corners of wider roads,
bends, long sweeps (+ left, - right), and straight on past side roads."""
_APART_M, _ROOM_M = 60.0, 32.0  # stretches farther apart along the road keep this distance
_ARM_M, _ARM_HALF_M = (28.0, 45.0), (2.6, 4.2)  # length and half the width of side roads

Piece = tuple[float, float, float]  # length in metres, curvature in 1/m at its start and at its end


class Arm(NamedTuple):
    """A side road, from the centre of a junction outwards."""

    xy: np.ndarray  # [2] centre of the junction
    heading_rad: float
    closed: bool  # by a barrier, which shows that the route goes elsewhere
    length_m: float
    half_m: float  # half its width


class Route(NamedTuple):
    """The path sampled every ``STEP_M``: s [N] from -BEHIND_M, xy [N,2], heading_rad [N],
    curvature_1pm [N].
    """

    s_m: np.ndarray
    xy: np.ndarray
    heading_rad: np.ndarray
    curvature_1pm: np.ndarray
    lane_m: float
    junctions_m: tuple[float, ...]  # s of their centres
    arms: tuple[Arm, ...]

    @property
    def right_m(self) -> float:
        """Offset of the road's right edge from the path (left is positive)."""
        return -IMU_LEFT_M - self.lane_m / 2 - 0.25

    @property
    def left_m(self) -> float:
        """Offset of the road's left edge."""
        return -IMU_LEFT_M + 1.5 * self.lane_m + 0.25

    @property
    def centre_m(self) -> float:
        """Offset of the line between the lanes."""
        return (self.left_m + self.right_m) / 2

    def at(
        self, s_m: np.ndarray | float, offset_m: np.ndarray | float = 0.0
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return points [..., 2] at `offset_m` to the left of the path, and headings [...]."""
        heading = np.interp(s_m, self.s_m, self.heading_rad)
        xy = np.stack([np.interp(s_m, self.s_m, self.xy[:, axis]) for axis in (0, 1)], axis=-1)
        left = np.stack([-np.sin(heading), np.cos(heading)], axis=-1)
        return xy + left * np.asarray(offset_m)[..., None], heading

    def curvature(self, s_m: np.ndarray) -> np.ndarray:
        """Return the curvature [...] at s_m [...]."""
        return np.interp(s_m, self.s_m, self.curvature_1pm)


def unit(heading_rad: np.ndarray | float) -> np.ndarray:
    """Return the unit vectors [..., 2] of headings [...]."""
    return np.stack([np.cos(heading_rad), np.sin(heading_rad)], axis=-1)


def rotation(x: float, y: float, z: float) -> np.ndarray:
    """Return the rotation [3,3] about x, then y, then z, by angles in rad."""
    R = np.eye(3)
    for axis, angle in enumerate((x, y, z)):
        c, s = np.cos(angle), np.sin(angle)
        i, j = (axis + 1) % 3, (axis + 2) % 3
        turn = np.eye(3)
        turn[i, i], turn[i, j], turn[j, i], turn[j, j] = c, -s, s, c
        R = turn @ R
    return R


def bend(angle_rad: float, radius_m: float, transition_m: float) -> list[Piece]:
    """Return the pieces clothoid, arc, clothoid for a turn by `angle_rad` (left positive) at
    `radius_m`.
    """
    # the clothoids turn by transition / radius
    transition_m = min(transition_m, abs(angle_rad) * radius_m)
    curvature = np.sign(angle_rad) / radius_m
    arc_m = abs(angle_rad) * radius_m - transition_m
    return [
        (transition_m, 0.0, curvature),
        (arc_m, curvature, curvature),
        (transition_m, curvature, 0.0),
    ]


def trace(pieces: list[Piece]) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return s [N], xy [N,2], heading [N], curvature [N] along `pieces`, from the origin
    eastwards.
    """
    knots = np.concatenate([[0.0], np.cumsum([piece[0] for piece in pieces])])
    s = np.arange(0, knots[-1], STEP_M)
    index = np.clip(np.searchsorted(knots, s, side="right") - 1, 0, len(pieces) - 1)
    lengths, first, last = np.array(pieces).T[:, index]
    curvature = first + (last - first) * (s - knots[index]) / np.maximum(lengths, 1e-9)
    heading = np.concatenate([[0.0], np.cumsum((curvature[1:] + curvature[:-1]) / 2 * STEP_M)])
    steps = unit((heading[1:] + heading[:-1]) / 2) * STEP_M
    return s, np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)]), heading, curvature


def draw_route(
    rng: np.random.Generator, length_m: float, lane_m: float, first: str = "crossing"
) -> Route:
    """Draw a road of at least `length_m` after the first frame that does not cross itself.

    It begins with the manoeuvre `first` of :data:`DECK`, often in the middle of it: otherwise all
    short drives would begin with a straight.
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
    s, xy, heading, curvature = (
        part[round((origin - BEHIND_M) / STEP_M) :] for part in trace(pieces)
    )
    s = s - origin
    stop = int(np.searchsorted(s, length_m))
    route = Route(s[:stop], xy[:stop], heading[:stop], curvature[:stop], lane_m, (), ())
    junctions, arms = [], []
    for kind, start, end in ((kind, start - origin, end - origin) for kind, start, end in begun):
        if kind in ("bend", "sweep") or end > s[stop - 1]:
            continue
        ways = _draw_arms(route, kind, start, end, rng)
        arms += ways
        junctions += [(start + end) / 2] * bool(ways)
    return route._replace(junctions_m=tuple(junctions), arms=tuple(arms))


def _manoeuvre(card: str, lane_m: float, rng: np.random.Generator) -> list[Piece]:
    """Draw the pieces of a card of the deck; radii are those of the rear axle."""
    kind, side = card.rstrip("+-"), -1 if card.endswith("-") else 1
    if kind == "right":
        return bend(-np.deg2rad(rng.uniform(75, 100)), rng.uniform(5.0, 7.0), rng.uniform(4, 6))
    if kind == "left":  # across the other lane
        return bend(
            np.deg2rad(rng.uniform(75, 100)),
            0.6 * lane_m + rng.uniform(4.7, 8.0),
            rng.uniform(5, 8),
        )
    if kind == "corner":
        return bend(side * np.deg2rad(rng.uniform(75, 100)), rng.uniform(9, 14), rng.uniform(7, 10))
    if kind == "bend":
        return bend(side * np.deg2rad(rng.uniform(35, 75)), rng.uniform(12, 30), rng.uniform(7, 11))
    if kind == "sweep":
        return bend(
            side * np.deg2rad(rng.uniform(12, 30)), rng.uniform(40, 200), rng.uniform(10, 15)
        )
    return [(rng.uniform(16, 22), 0.0, 0.0)]


def _clear_of_itself(route: Route) -> bool:
    """Return whether no two stretches of road are close and no arm reaches another stretch."""
    every = int(1 / STEP_M)
    s, xy = route.s_m[::every], route.xy[::every]
    far = np.abs(s[:, None] - s[None]) > _APART_M
    if (np.linalg.norm(xy[:, None] - xy[None], axis=-1)[far] < _ROOM_M).any():
        return False
    for arm in route.arms:
        beyond_mouth = arm.xy + np.arange(14, arm.length_m)[:, None] * unit(arm.heading_rad)
        if (np.linalg.norm(beyond_mouth[:, None] - xy[None], axis=-1) < 8).any():
            return False
    return True


def _draw_arms(
    route: Route, kind: str, start: float, end: float, rng: np.random.Generator
) -> list[Arm]:
    """Draw the side roads of a crossing, or of a junction where the ego turns, from s = `start` to
    `end`.

    Those of a turn are closed: otherwise the image would not show which way the ego goes.
    """
    first, heading_in = route.at(start, route.centre_m)
    last, heading_out = route.at(end, route.centre_m)
    length, half = rng.uniform(*_ARM_M), rng.uniform(*_ARM_HALF_M)
    if kind == "crossing":
        square = heading_in + np.pi / 2 + np.deg2rad(rng.uniform(-10, 10))
        sides = [[0.0], [np.pi], [0.0, np.pi]][rng.integers(3)]
        return [
            Arm((first + last) / 2, float(square + turn), False, length, half) for turn in sides
        ]
    # The roads' centre lines intersect at the junction.
    into, out = unit(heading_in), unit(heading_out)
    middle = first + np.linalg.solve(np.stack([into, -out], axis=1), last - first)[0] * into
    which = rng.integers(4)  # corner | T-junction, entered from its stem | straight on | both
    headings = [float(heading_out + np.pi)] * (which in (1, 3)) + [float(heading_in)] * (
        which in (2, 3)
    )
    return [Arm(middle, heading, True, length, half) for heading in headings]
