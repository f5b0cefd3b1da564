"""Draw the path of the ego: straights, bends with clothoid transitions, turns at crossings.

The axes of the world are x east, y north and z up, in metres. Headings are counter-clockwise from
east. The path is that of the IMU, over the rear axle. Its curvature is continuous and piecewise
linear in arc length, which makes the steering label exact.
"""

from typing import NamedTuple

import numpy as np

# Distance in metres between two samples of a route.
STEP_M = 0.1
# Length in metres of the road behind the first frame, which the LiDAR sees.
BEHIND_M = 40.0
# Length in metres of the road ahead of the last frame, which the camera sees.
AHEAD_M = 110.0
# Height in metres of the IMU over the road.
IMU_HEIGHT_M = 0.93
# Offset in metres of the IMU to the left of the car's centre line, as in KITTI. The car is centred
# in its lane.
IMU_LEFT_M = 0.3

# Sides of a road, as signs of offsets from the path.
LEFT = 1
RIGHT = -1
SIDES = (LEFT, RIGHT)

# Manoeuvres, which are shuffled like cards for every road. `right` and `left` are turns at
# junctions. A corner has a larger radius, a bend turns less, and a sweep is long and turns least;
# + is to the left, - to the right. `crossing` goes straight on past side roads.
DECK = ("right", "bend+", "crossing", "left", "sweep-", "corner+", "bend-", "sweep+", "corner-")

# Smallest distance in metres along the road between two places that must not be close to each
# other.
_APART_M = 60.0
# Smallest distance in metres between two such places.
_ROOM_M = 32.0
# Range of the lengths of side roads in metres.
_ARM_M = (28.0, 45.0)
# Range of half the widths of side roads in metres.
_ARM_HALF_M = (2.6, 4.2)


class Piece(NamedTuple):
    """A piece of the path whose curvature changes linearly; by default it is straight."""

    length_m: float
    start_1pm: float = 0.0
    end_1pm: float = 0.0


class _Turn(NamedTuple):
    """Ranges of a turn's angle, of the rear axle's radius, and of the length of its transitions."""

    angle_deg: tuple[float, float]
    radius_m: tuple[float, float]
    transition_m: tuple[float, float]


# Kind of manoeuvre in the deck → its turn.
_TURNS = {
    "right": _Turn((75, 100), (5.0, 7.0), (4, 6)),
    "left": _Turn((75, 100), (4.7, 8.0), (5, 8)),
    "corner": _Turn((75, 100), (9, 14), (7, 10)),
    "bend": _Turn((35, 75), (12, 30), (7, 11)),
    "sweep": _Turn((12, 30), (40, 200), (10, 15)),
}


class Manoeuvre(NamedTuple):
    """A manoeuvre of :data:`DECK`, without its sign, and where along the road it is."""

    kind: str
    start_m: float
    end_m: float


class Arm(NamedTuple):
    """A side road, from the centre of a junction outwards."""

    xy: np.ndarray  # [2], centre of the junction
    heading_rad: float
    closed: bool  # whether a barrier shows that the route does not go there
    length_m: float
    half_m: float  # half its width

    def place_at(self, distance_m: np.ndarray | float) -> np.ndarray:
        """Return the points [..., 2] at `distance_m` [...] from the centre of the junction."""
        return self.xy + np.asarray(distance_m)[..., None] * unit_vector(self.heading_rad)


class Route(NamedTuple):
    """The path, sampled every ``STEP_M``."""

    s_m: np.ndarray  # [N], distance along the path, from -BEHIND_M; 0 at the first frame
    xy: np.ndarray  # [N,2]
    heading_rad: np.ndarray  # [N]
    curvature_1pm: np.ndarray  # [N]
    lane_m: float
    junctions_m: tuple[float, ...]  # s_m of the junctions' centres
    arms: tuple[Arm, ...]

    def edge_m(self, side: int) -> float:
        """Return the offset of the road's edge from the path, on a side of :data:`SIDES`."""
        if side == LEFT:
            return -IMU_LEFT_M + 1.5 * self.lane_m + 0.25
        return -IMU_LEFT_M - self.lane_m / 2 - 0.25

    @property
    def centre_m(self) -> float:
        """Offset of the line between the lanes from the path (left is positive)."""
        return (self.edge_m(LEFT) + self.edge_m(RIGHT)) / 2

    def place_at(
        self, s_m: np.ndarray | float, offset_m: np.ndarray | float = 0.0
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return points [..., 2] at `offset_m` to the left of the path, and headings [...]."""
        path_x, path_y = self.xy.T
        x = np.interp(s_m, self.s_m, path_x)
        y = np.interp(s_m, self.s_m, path_y)
        heading_rad = np.interp(s_m, self.s_m, self.heading_rad)
        left = np.stack([-np.sin(heading_rad), np.cos(heading_rad)], axis=-1)
        offset = left * np.asarray(offset_m)[..., None]
        return np.stack([x, y], axis=-1) + offset, heading_rad

    def curvature(self, s_m: np.ndarray) -> np.ndarray:
        """Return the curvature [...] at s_m [...]."""
        return np.interp(s_m, self.s_m, self.curvature_1pm)


def unit_vector(heading_rad: np.ndarray | float) -> np.ndarray:
    """Return the unit vectors [..., 2] of headings [...]."""
    return np.stack([np.cos(heading_rad), np.sin(heading_rad)], axis=-1)


def rotation_matrix(x: float, y: float, z: float) -> np.ndarray:
    """Return the rotation [3,3] about x, then y, then z, by angles in rad."""
    R = np.eye(3)
    for axis, angle in enumerate((x, y, z)):
        c = np.cos(angle)
        s = np.sin(angle)
        i = (axis + 1) % 3
        j = (axis + 2) % 3
        turn = np.eye(3)
        turn[i, i] = c
        turn[i, j] = -s
        turn[j, i] = s
        turn[j, j] = c
        R = turn @ R
    return R


def bend_pieces(angle_rad: float, radius_m: float, transition_m: float) -> list[Piece]:
    """Return clothoid, arc and clothoid for a turn by `angle_rad` (left positive)."""
    # A clothoid turns half as much per metre as the arc, on average.
    turn_m = abs(angle_rad) * radius_m
    transition_m = min(transition_m, turn_m)
    curvature_1pm = np.sign(angle_rad) / radius_m
    return [
        Piece(transition_m, end_1pm=curvature_1pm),
        Piece(turn_m - transition_m, curvature_1pm, curvature_1pm),
        Piece(transition_m, start_1pm=curvature_1pm),
    ]


def trace_path(pieces: list[Piece]) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return s [N], xy [N,2], heading [N] and curvature [N] along `pieces`.

    The path starts at the origin, eastwards.
    """
    lengths_m = [piece.length_m for piece in pieces]
    knots_m = np.concatenate([[0.0], np.cumsum(lengths_m)])
    s_m = np.arange(0, knots_m[-1], STEP_M)

    # Curvature is linear within a piece.
    index = np.searchsorted(knots_m, s_m, side="right") - 1
    index = np.minimum(index, len(pieces) - 1)
    length_m, start_1pm, end_1pm = np.array(pieces)[index].T
    within_m = s_m - knots_m[index]
    curvature = start_1pm + (end_1pm - start_1pm) * within_m / length_m

    # The heading is the integral of the curvature, places are the integral of the heading.
    turned = (curvature[1:] + curvature[:-1]) / 2 * STEP_M
    heading = np.concatenate([[0.0], np.cumsum(turned)])
    steps = unit_vector((heading[1:] + heading[:-1]) / 2) * STEP_M
    xy = np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
    return s_m, xy, heading, curvature


def draw_route(rng: np.random.Generator, length_m: float, lane_m: float, first: str) -> Route:
    """Draw a road of at least `length_m` after the first frame that does not cross itself.

    It begins with the manoeuvre `first` of :data:`DECK`. The first frame is often in the middle of
    this manoeuvre, since otherwise all short drives would begin with a straight.
    """
    while True:
        route = _draw_road(rng, length_m, lane_m, first)
        if _clear_of_itself(route):
            return route


def _draw_road(rng: np.random.Generator, length_m: float, lane_m: float, first: str) -> Route:
    """Draw a road that may cross itself."""
    pieces, manoeuvres = _draw_pieces(rng, length_m, lane_m, first)

    # The first frame is at most 12 m before the first manoeuvre, or in it.
    _, start_m, end_m = manoeuvres[0]
    origin_m = rng.uniform(start_m - 12.0, start_m + 0.6 * (end_m - start_m))
    origin_m = round(origin_m / STEP_M) * STEP_M
    s_m, xy, heading_rad, curvature_1pm = trace_path(pieces)
    s_m = s_m - origin_m
    begin = round((origin_m - BEHIND_M) / STEP_M)
    part = slice(begin, np.searchsorted(s_m, length_m))
    path = Route(
        s_m[part],
        xy[part],
        heading_rad[part],
        curvature_1pm[part],
        lane_m=lane_m,
        junctions_m=(),
        arms=(),
    )

    # Draw side roads at the manoeuvres that are at junctions.
    junctions_m = []
    arms = []
    for kind, start_m, end_m in manoeuvres:
        start_m -= origin_m
        end_m -= origin_m
        if kind in ("bend", "sweep") or end_m > path.s_m[-1]:
            continue
        side_roads = _draw_arms(path, Manoeuvre(kind, start_m, end_m), rng)
        arms += side_roads
        if side_roads:
            junctions_m.append((start_m + end_m) / 2)
    return path._replace(junctions_m=tuple(junctions_m), arms=tuple(arms))


def _draw_pieces(
    rng: np.random.Generator, length_m: float, lane_m: float, first: str
) -> tuple[list[Piece], list[Manoeuvre]]:
    """Draw the pieces of a road, and the manoeuvres that they make."""
    pieces = [Piece(2 * BEHIND_M)]
    manoeuvres: list[Manoeuvre] = []
    while _total_length(pieces) < 2 * BEHIND_M + length_m:
        cards = rng.permutation(DECK).tolist()
        if not manoeuvres:
            cards.remove(first)
            cards.insert(0, first)
        for card in cards:
            start_m = _total_length(pieces)
            pieces += _draw_manoeuvre(card, lane_m, rng)
            manoeuvres.append(Manoeuvre(card.rstrip("+-"), start_m, _total_length(pieces)))
            pieces.append(Piece(rng.uniform(4, 20)))
    return pieces, manoeuvres


def _total_length(pieces: list[Piece]) -> float:
    """Return the length of the pieces in metres."""
    return sum(piece.length_m for piece in pieces)


def _draw_manoeuvre(card: str, lane_m: float, rng: np.random.Generator) -> list[Piece]:
    """Draw the pieces of a manoeuvre of the deck."""
    if card == "crossing":
        return [Piece(rng.uniform(16, 22))]
    turn = _TURNS[card.rstrip("+-")]
    angle_rad = np.deg2rad(rng.uniform(*turn.angle_deg))
    radius_m = rng.uniform(*turn.radius_m)
    if card == "left":
        radius_m += 0.6 * lane_m  # the turn crosses the other lane
    if card == "right" or card.endswith("-"):
        angle_rad = -angle_rad
    return bend_pieces(angle_rad, radius_m, rng.uniform(*turn.transition_m))


def _clear_of_itself(route: Route) -> bool:
    """Return whether the road keeps away from its own distant stretches and from all arms."""
    every = int(1 / STEP_M)
    s_m = route.s_m[::every]
    xy = route.xy[::every]
    far = np.abs(s_m[:, None] - s_m) > _APART_M
    distance_m = np.linalg.norm(xy[:, None] - xy, axis=-1)
    if (distance_m[far] < _ROOM_M).any():
        return False

    for arm in route.arms:
        # The first metres of an arm are close to its own junction.
        beyond_mouth = arm.place_at(np.arange(14, arm.length_m))
        distance_m = np.linalg.norm(beyond_mouth[:, None] - xy, axis=-1)
        if (distance_m < 8).any():
            return False
    return True


def _draw_arms(path: Route, manoeuvre: Manoeuvre, rng: np.random.Generator) -> list[Arm]:
    """Draw the side roads of a crossing, or of a junction where the ego turns.

    The side roads of a turn are closed, since otherwise the image would not show which way the ego
    goes.
    """
    kind, start_m, end_m = manoeuvre
    start, heading_in = path.place_at(start_m, path.centre_m)
    end, heading_out = path.place_at(end_m, path.centre_m)
    length_m = rng.uniform(*_ARM_M)
    half_m = rng.uniform(*_ARM_HALF_M)
    if kind == "crossing":
        centre = (start + end) / 2
        left = heading_in + np.pi / 2 + np.deg2rad(rng.uniform(-10, 10))
        right = left + np.pi
        headings = [[left], [right], [left, right]][rng.integers(3)]
    else:
        # The roads' centre lines intersect at the junction.
        into = unit_vector(heading_in)
        out = unit_vector(heading_out)
        to_centre_m, _ = np.linalg.solve(np.stack([into, -out], axis=1), end - start)
        centre = start + to_centre_m * into
        # A corner has no arm, a T-junction one of these two, and crossroads have both.
        ahead = heading_in
        opposite = heading_out + np.pi
        headings = [[], [opposite], [ahead], [opposite, ahead]][rng.integers(4)]
    closed = kind != "crossing"
    return [Arm(centre, float(heading), closed, length_m, half_m) for heading in headings]
