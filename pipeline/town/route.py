"""Where the ego drives: a path of straights, bends with clothoid transitions, and junctions.

World frame: x east, y north, z up, metres; headings counter-clockwise from east. The path is that of the IMU (the rear
axle): its curvature is continuous and piecewise linear in arc length, so that the steering label is exact.
"""

from dataclasses import dataclass

import numpy as np

STEP_M = 0.1
BEHIND_M = 40.0  # road behind the first frame, for the LiDAR
AHEAD_M = 110.0  # road ahead of the last frame, for the camera
IMU_LEFT_M = 0.3  # the IMU sits left of the car's middle, as in KITTI; the car's middle keeps to its lane's

Piece = tuple[float, float, float]
"""Length in metres, curvature in 1/m at its start and at its end."""


@dataclass(frozen=True)
class Arm:
    """A road that the ego does not take, from the middle of a junction outwards."""

    xy: np.ndarray  # [2] middle of the junction
    heading_rad: float
    closed: bool  # a barrier stands across it, so that a driver sees that the way lies elsewhere
    length_m: float


@dataclass(frozen=True)
class Route:
    """The path sampled every ``STEP_M``: s [N] from -BEHIND_M, xy [N,2], heading_rad [N], curvature_1pm [N]."""

    s_m: np.ndarray
    xy: np.ndarray
    heading_rad: np.ndarray
    curvature_1pm: np.ndarray
    lane_m: float
    junctions_m: tuple[float, ...]  # s of their middles
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

    def at(self, s_m: np.ndarray | float, offset_m: np.ndarray | float = 0.0) -> tuple[np.ndarray, np.ndarray]:
        """Return points [..., 2] at `offset_m` to the left of the path, and headings [...]."""
        heading = np.interp(s_m, self.s_m, self.heading_rad)
        xy = np.stack([np.interp(s_m, self.s_m, self.xy[:, axis]) for axis in (0, 1)], axis=-1)
        left = np.stack([-np.sin(heading), np.cos(heading)], axis=-1)
        return xy + left * np.asarray(offset_m)[..., None], heading

    def curvature(self, s_m: np.ndarray) -> np.ndarray:
        return np.interp(s_m, self.s_m, self.curvature_1pm)


def unit(heading_rad: np.ndarray | float) -> np.ndarray:
    """Return the unit vectors [..., 2] of headings [...]."""
    return np.stack([np.cos(heading_rad), np.sin(heading_rad)], axis=-1)


def draw_route(rng: np.random.Generator, length_m: float) -> Route:
    """Draw a route of at least `length_m` from the first frame on that keeps clear of itself and turns both ways."""
    while True:
        route = _draw(rng, length_m)
        if _turns_both_ways(route, length_m) and _clear_of_itself(route):
            return route


def bend(angle_rad: float, radius_m: float, transition_m: float) -> list[Piece]:
    """Return clothoid, arc, clothoid that turn by `angle_rad` (left positive) at `radius_m`."""
    transition_m = min(transition_m, abs(angle_rad) * radius_m)  # both clothoids together turn by transition / radius
    curvature = np.sign(angle_rad) / radius_m
    arc_m = abs(angle_rad) * radius_m - transition_m
    return [(transition_m, 0.0, curvature), (arc_m, curvature, curvature), (transition_m, curvature, 0.0)]


def trace(pieces: list[Piece]) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return s [N], xy [N,2], heading [N], curvature [N] along `pieces`, from the origin eastwards."""
    knots = np.concatenate([[0.0], np.cumsum([piece[0] for piece in pieces])])
    s = np.arange(0, knots[-1], STEP_M)
    index = np.clip(np.searchsorted(knots, s, side="right") - 1, 0, len(pieces) - 1)
    lengths, first, last = np.array(pieces).T[:, index]
    curvature = first + (last - first) * (s - knots[index]) / np.maximum(lengths, 1e-9)
    heading = np.concatenate([[0.0], np.cumsum((curvature[1:] + curvature[:-1]) / 2 * STEP_M)])
    middle = (heading[1:] + heading[:-1]) / 2
    steps = unit(middle) * STEP_M
    return s, np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)]), heading, curvature


def _draw(rng: np.random.Generator, length_m: float) -> Route:
    pieces: list[Piece] = [(BEHIND_M + rng.uniform(0, 8), 0.0, 0.0)]
    turns: list[tuple[str, float, float]] = []  # kind, s where it begins, s where it ends
    while sum(piece[0] for piece in pieces) < BEHIND_M + length_m:
        sign = rng.choice([-1, 1])
        deck = ["turn+", "turn-", "bend+", "bend-", "sweep+" if sign > 0 else "sweep-", "crossing"]
        for card in rng.permutation(deck):
            if sum(piece[0] for piece in pieces) > BEHIND_M + length_m:
                break
            kind, side = card.rstrip("+-"), -1 if card.endswith("-") else 1
            start = sum(piece[0] for piece in pieces)
            pieces += _manoeuvre(kind, side, rng)
            turns.append((kind, start, sum(piece[0] for piece in pieces)))
            pieces.append((rng.uniform(2, 8), 0.0, 0.0))
    s, xy, heading, curvature = trace(pieces)
    s = s - BEHIND_M
    route = Route(s, xy, heading, curvature, rng.uniform(3.3, 3.7), (), ())
    junctions, arms = [], []
    for kind, start, end in turns:
        if kind in ("turn", "crossing"):
            draw = turn_arms if kind == "turn" else _crossing_arms
            ways = draw(route, start - BEHIND_M, end - BEHIND_M, rng)
            arms += ways
            if ways:
                junctions.append((start + end) / 2 - BEHIND_M)
    return Route(s, xy, heading, curvature, route.lane_m, tuple(junctions), tuple(arms))


def _manoeuvre(kind: str, side: int, rng: np.random.Generator) -> list[Piece]:
    if kind == "turn":
        return bend(side * np.deg2rad(rng.uniform(75, 100)), rng.uniform(9, 14), rng.uniform(7, 10))
    if kind == "bend":
        return bend(side * np.deg2rad(rng.uniform(35, 75)), rng.uniform(12, 30), rng.uniform(7, 11))
    if kind == "sweep":
        return bend(side * np.deg2rad(rng.uniform(12, 30)), rng.uniform(40, 200), rng.uniform(10, 15))
    return [(rng.uniform(16, 22), 0.0, 0.0)]


def _crossing_arms(route: Route, start: float, end: float, rng: np.random.Generator) -> list[Arm]:
    first, heading_in = route.at(start, route.centre_m)
    last, _ = route.at(end, route.centre_m)
    length = rng.uniform(28, 45)
    square = heading_in + np.pi / 2 + np.deg2rad(rng.uniform(-10, 10))
    sides = [[0.0], [np.pi], [0.0, np.pi]][rng.integers(3)]
    return [Arm((first + last) / 2, float(square + turn), False, length) for turn in sides]


def turn_arms(route: Route, start: float, end: float, rng: np.random.Generator) -> list[Arm]:
    """Draw which of the ways that the ego does not take exist where it turns from s `start` to `end`: closed ones."""
    first, heading_in = route.at(start, route.centre_m)
    last, heading_out = route.at(end, route.centre_m)
    length = rng.uniform(28, 45)
    # The roads' middle lines meet at the junction; every way but the driven one is closed or absent.
    into, out = unit(heading_in), unit(heading_out)
    along = np.linalg.solve(np.stack([into, -out], axis=1), last - first)[0]
    middle = first + along * into
    which = rng.integers(4)  # a plain corner | a T, coming from its stem | straight on closed | both
    arms = [float(heading_out + np.pi)] * (which in (1, 3)) + [float(heading_in)] * (which in (2, 3))
    return [Arm(middle, heading, True, length) for heading in arms]


def arm_is_clear(arm: Arm, xy: np.ndarray) -> bool:
    """No point of the path xy [N,2] comes close to the arm beyond its mouth."""
    along = np.arange(14, arm.length_m)[:, None]
    points = arm.xy + along * unit(arm.heading_rad)
    return not (np.linalg.norm(points[:, None] - xy[None], axis=-1) < 8).any()


def _turns_both_ways(route: Route, length_m: float) -> bool:
    """In the stretch that will be driven, sharp bends lie left and right; a short one has no room for both."""
    driven = route.curvature_1pm[(route.s_m > 0) & (route.s_m < 0.7 * (length_m - AHEAD_M))]
    return len(driven) * STEP_M < 60 or bool(driven.max() > 0.04 and driven.min() < -0.04)


def _clear_of_itself(route: Route, room_m: float = 32.0) -> bool:
    """No two stretches of road come close to each other, and no arm reaches another stretch."""
    every = int(1 / STEP_M)
    s, xy = route.s_m[::every], route.xy[::every]
    far = np.abs(s[:, None] - s[None]) > 60
    if (np.linalg.norm(xy[:, None] - xy[None], axis=-1)[far] < room_m).any():
        return False
    return all(arm_is_clear(arm, xy) for arm in route.arms)
