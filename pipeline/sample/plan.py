"""Draw the quarter that a drive crosses, and the plan of its ground.

The plan is a raster. Each cell has a kind of ground, and its distance to the road.
"""

from typing import NamedTuple

import cv2
import numpy as np

from pipeline.sample.route import LEFT, RIGHT, SIDES, STEP_M, Route, unit_vector

# Side of a cell of the plan in metres.
CELL_M = 0.1
# Margin of the plan around the route and its arms in metres.
MARGIN_M = 45.0
# Height in metres of pavement and grass over roads, which are at z = 0.
KERB_M = 0.12
# Radius of the kerb at junctions in metres.
CORNER_M = 4.0
# Width of a parking bay in metres.
BAY_M = 2.1
# Height of a house's storey in metres.
STOREY_M = 2.9

# Kinds of ground, the values of a plan's cells.
GRASS, PAVEMENT, ASPHALT, MARKING, BAY, KERBSTONE = range(6)

# Samples of the route at which the plan is painted, every half metre.
_PAINTED = slice(None, None, round(0.5 / STEP_M))


class Quarter(NamedTuple):
    """Ranges and probabilities that all streets of a quarter share."""

    setback_m: tuple[float, float]  # distance between pavement and houses
    storeys: tuple[int, int]  # number of storeys of a house
    gap_m: tuple[float, float]  # distance between houses
    trees: float  # probability of a tree at each place
    hedges: float  # probability of a hedge at each place
    bays: float  # probability that a side of the road has parking bays
    cruise_mps: tuple[float, float] = (6.5, 10.0)  # speed on a straight road
    # Whether cars park at both kerbs, and the road has no markings. Otherwise cars park in bays
    # beside the lanes.
    kerbside: bool = False


# Name of a quarter → its streets.
QUARTERS = {
    "centre": Quarter(
        setback_m=(0.0, 0.6),
        storeys=(3, 6),
        gap_m=(0.0, 3.0),
        trees=0.3,
        hedges=0.0,
        bays=0.8,
    ),
    "narrow": Quarter(
        setback_m=(0.0, 3.0),
        storeys=(2, 4),
        gap_m=(0.0, 6.0),
        trees=0.3,
        hedges=0.5,
        bays=1.0,
        cruise_mps=(5.0, 8.0),
        kerbside=True,
    ),
    "suburb": Quarter(
        setback_m=(4.0, 9.0),
        storeys=(1, 3),
        gap_m=(4.0, 12.0),
        trees=0.8,
        hedges=0.6,
        bays=0.5,
    ),
    "terraces": Quarter(
        setback_m=(1.5, 4.0),
        storeys=(2, 4),
        gap_m=(0.0, 6.0),
        trees=0.5,
        hedges=0.4,
        bays=0.7,
    ),
    "village": Quarter(
        setback_m=(2.0, 12.0),
        storeys=(1, 3),
        gap_m=(6.0, 25.0),
        trees=0.9,
        hedges=0.3,
        bays=0.4,
    ),
}


class Character(NamedTuple):
    """Dimensions of a drive's streets, and how many cars park there."""

    quarter: Quarter
    lane_m: float  # width of a lane
    pavement_m: float  # width of the pavement
    parked: float  # probability of a parked car at each place


def draw_character(rng: np.random.Generator, quarter: str) -> Character:
    """Draw the character of the streets in a quarter of :data:`QUARTERS`."""
    lane_m = rng.uniform(3.1, 3.7)
    pavement_m = rng.uniform(1.8, 3.0)
    parked = rng.uniform(0.5, 0.85)
    # In narrow streets, parked cars leave little more width than two cars need. So lanes are
    # narrow, and the ego drives close to the middle.
    narrow_lane_m = rng.uniform(2.0, 2.5)
    narrow_pavement_m = rng.uniform(1.3, 2.2)
    narrow_parked = rng.uniform(0.55, 0.95)
    if quarter == "narrow":
        return Character(QUARTERS[quarter], narrow_lane_m, narrow_pavement_m, narrow_parked)
    return Character(QUARTERS[quarter], lane_m, pavement_m, parked)


class Plan(NamedTuple):
    """The ground of a drive, in cells of ``CELL_M``, and where cars park along the route."""

    kind: np.ndarray  # uint8 [Y,X], a kind of ground from GRASS to KERBSTONE
    to_road_m: np.ndarray  # float32 [Y,X], distance to the road
    origin: np.ndarray  # [2], x and y of cell (0, 0) in the world
    bays: dict[int, np.ndarray]  # side → width for parked cars at the route's samples [N]
    parking: np.ndarray  # bool [N], whether cars may park at the route's samples

    @property
    def size_m(self) -> np.ndarray:
        """Extent of the plan along x and y, [2]."""
        return np.array(self.kind.shape[::-1]) * CELL_M

    def cells_at(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return rows and columns [...] of the cells at x, y [...], clipped to the border."""
        rows, columns = self.kind.shape
        left, bottom = self.origin
        row = np.rint((y - bottom) / CELL_M).astype(np.int64).clip(0, rows - 1)
        column = np.rint((x - left) / CELL_M).astype(np.int64).clip(0, columns - 1)
        return row, column

    def trace_kerbs(self) -> list[np.ndarray]:
        """Return the closed outlines of the roads, each [N,2] in metres."""
        road = (self.to_road_m <= 0).astype(np.uint8)
        outlines, _ = cv2.findContours(road, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
        kerbs = []
        for outline in outlines:
            corners = cv2.approxPolyDP(outline, 0.7, True)[:, 0]
            if len(corners) > 2:
                kerbs.append(corners * CELL_M + self.origin)
        return kerbs


def draw_plan(route: Route, rng: np.random.Generator, character: Character) -> Plan:
    """Paint the road, its arms, pavements, parking bays and markings."""
    # The plan covers the route and its arms, with a margin.
    points = np.vstack([route.xy, *(arm.place_at(arm.length_m) for arm in route.arms)])
    origin = points.min(axis=0) - MARGIN_M
    width, height = np.ceil((points.max(axis=0) + MARGIN_M - origin) / CELL_M).astype(int)

    # A road covers its lanes and bays. The corners between roads are round.
    parking = _may_park(route, character.quarter.kerbside)
    bays = {side: _draw_bays(route, parking, rng, character.quarter) for side in SIDES}
    road = np.zeros((height, width), np.uint8)
    left = _outer_edge(route, bays, LEFT)
    right = _outer_edge(route, bays, RIGHT)
    _paint_band(road, left, right, origin, value=1)
    for arm in route.arms:
        ends = arm.place_at(np.array([0.0, arm.length_m]))
        to_left = arm.half_m * unit_vector(arm.heading_rad + np.pi / 2)
        _paint_band(road, ends + to_left, ends - to_left, origin, value=1)
    road = _close_mask(road, CORNER_M)

    # Beside the road are kerbstones, then pavement, then grass.
    to_road_m = _distance_m(road)
    kind = np.full(road.shape, GRASS, np.uint8)
    kind[to_road_m < character.pavement_m] = PAVEMENT
    kind[to_road_m < 0.25] = KERBSTONE
    kind[road > 0] = ASPHALT
    if not character.quarter.kerbside:
        paint = np.zeros_like(kind)
        _paint_markings(paint, route, bays, origin, rng)
        kind = np.where((paint > 0) & (road > 0), paint, kind)
    return Plan(kind, to_road_m, origin, bays, parking)


def _may_park(route: Route, kerbside: bool) -> np.ndarray:
    """Return whether cars may park at each sample of the route, bool [N].

    They park neither in sharp bends nor close to junctions. At kerbs the limits are less strict
    than for bays.
    """
    if kerbside:
        sharp_1pm = 0.085
        clearance_m = 9.0
    else:
        sharp_1pm = 0.055
        clearance_m = 13.0
    blocked = np.abs(route.curvature_1pm) > sharp_1pm
    for junction_m in route.junctions_m:
        blocked |= np.abs(route.s_m - junction_m) < clearance_m

    # Places within two metres of blocked samples are blocked, too.
    reach = round(2 / STEP_M)
    return np.convolve(blocked, np.ones(2 * reach + 1), "same") == 0


def _draw_bays(
    route: Route, parking: np.ndarray, rng: np.random.Generator, quarter: Quarter
) -> np.ndarray:
    """Draw the width for parked cars at each sample [N]: everywhere at kerbs, else in bays."""
    width_m = np.zeros(len(route.s_m))
    if quarter.kerbside:
        width_m[:] = BAY_M
    elif rng.random() < quarter.bays:
        start_m = route.s_m[0]
        while start_m < route.s_m[-1]:
            end_m = start_m + rng.uniform(20, 60)
            width_m[(route.s_m >= start_m) & (route.s_m < end_m)] = BAY_M
            start_m = end_m + rng.uniform(6, 20)
        width_m[~parking] = 0

    # The width of a bay increases and decreases over two metres.
    ramp = round(2 / STEP_M)
    return np.convolve(width_m, np.ones(ramp) / ramp, "same")


def _outer_edge(route: Route, bays: dict[int, np.ndarray], side: int) -> np.ndarray:
    """Return the points of the kerb on a side, beyond the bays, at the painted samples [M,2]."""
    offset_m = route.edge_m(side) + side * bays[side][_PAINTED]
    xy, _ = route.place_at(route.s_m[_PAINTED], offset_m)
    return xy


def _close_mask(mask: np.ndarray, radius_m: float) -> np.ndarray:
    """Round the corners between roads by morphological closing with a disc."""
    outside = (_distance_m(mask) > radius_m).astype(np.uint8)
    closed = _distance_m(outside) > radius_m
    return (closed | (mask > 0)).astype(np.uint8)


def _distance_m(mask: np.ndarray) -> np.ndarray:
    """Return the distance of each cell to the cells where `mask` is 1, float32 [Y,X]."""
    return cv2.distanceTransform(1 - mask, cv2.DIST_L2, 5) * CELL_M


def _paint_markings(
    paint: np.ndarray,
    route: Route,
    bays: dict[int, np.ndarray],
    origin: np.ndarray,
    rng: np.random.Generator,
) -> None:
    """Paint bays, a line between the lanes, and in some drives lines along the edges."""
    s_m = route.s_m[_PAINTED]
    for side in SIDES:
        inner_edge, _ = route.place_at(s_m, route.edge_m(side))
        _paint_band(paint, inner_edge, _outer_edge(route, bays, side), origin, value=BAY)

    # No lines cross a junction.
    clear = np.full(len(s_m), True)
    for junction_m in route.junctions_m:
        clear &= np.abs(s_m - junction_m) > 11
    dash = (s_m % 5) < 2.5  # 2.5 m on, 2.5 m off
    _paint_line(paint, route, clear & dash, offset_m=route.centre_m, origin=origin)
    if rng.random() < 0.5:
        for side in SIDES:
            offset_m = route.edge_m(side) - side * 0.15
            _paint_line(paint, route, clear, offset_m=offset_m, origin=origin)


def _paint_band(
    canvas: np.ndarray, left: np.ndarray, right: np.ndarray, origin: np.ndarray, value: int
) -> None:
    """Fill the band between two lines [M,2] with `value`."""
    for i in range(len(left) - 1):
        quad = np.array([left[i], left[i + 1], right[i + 1], right[i]])
        cv2.fillConvexPoly(canvas, _to_fixed_point(quad, origin), value, shift=4)


def _paint_line(
    canvas: np.ndarray, route: Route, painted: np.ndarray, offset_m: float, origin: np.ndarray
) -> None:
    """Paint a line at `offset_m` from the path where it is `painted`, bool [M]."""
    xy, _ = route.place_at(route.s_m[_PAINTED], offset_m)
    points = _to_fixed_point(xy, origin).tolist()
    for i in np.flatnonzero(painted[:-1]):
        cv2.line(canvas, points[i], points[i + 1], MARKING, 2, shift=4)


def _to_fixed_point(xy: np.ndarray, origin: np.ndarray) -> np.ndarray:
    """Convert world metres to OpenCV's fixed-point pixels with four fractional bits."""
    return np.rint((xy - origin) / CELL_M * 16).astype(np.int32)
