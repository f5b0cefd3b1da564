"""Draw the quarter that a drive crosses, and its ground plan: a raster of ground kinds and
distances to the road.
"""

from typing import NamedTuple

import cv2
import numpy as np

from pipeline.sample.route import STEP_M, Route, unit

CELL_M = 0.1
MARGIN_M = 45.0
KERB_M = 0.12  # height of pavement and grass over roads, which are at z = 0
GRASS, PAVEMENT, ASPHALT, MARKING, BAY, KERBSTONE = range(6)
CORNER_M = 4.0  # kerb radius at junctions
BAY_M = 2.1  # width for a parked car
_EVERY = slice(None, None, round(0.5 / STEP_M))  # samples of the route that are painted


class Character(NamedTuple):
    """Dimensions and densities of a quarter's streets."""

    lane_m: float
    cruise_mps: tuple[float, float]
    # cars park at both kerbs of a street without markings; otherwise in bays beside the lanes
    kerbside: bool
    pavement_m: float
    setback_m: tuple[float, float]  # of houses, behind the pavement
    storeys: tuple[int, int]
    gap_m: tuple[float, float]  # between houses
    trees: float  # probability per place, 0..1
    hedges: float
    bays: float  # probability that a side of the road has parking bays
    parked: float  # probability per place


QUARTERS = ("centre", "narrow", "suburb", "terraces", "village")


def draw_character(rng: np.random.Generator, quarter: str) -> Character:
    """Draw the streets' dimensions and densities in a quarter of :data:`QUARTERS`."""
    lane, pavement, parked = rng.uniform(3.1, 3.7), rng.uniform(1.8, 3.0), rng.uniform(0.5, 0.85)
    wide = (lane, (6.5, 10.0), False, pavement)
    # Parked cars leave little more room than two cars need: the ego drives close to the middle.
    narrow = (rng.uniform(2.0, 2.5), (5.0, 8.0), True, rng.uniform(1.3, 2.2))
    table = {
        "centre": Character(*wide, (0.0, 0.6), (3, 6), (0.0, 3.0), 0.3, 0.0, 0.8, parked),
        "narrow": Character(
            *narrow, (0.0, 3.0), (2, 4), (0.0, 6.0), 0.3, 0.5, 1.0, rng.uniform(0.55, 0.95)
        ),
        "suburb": Character(*wide, (4.0, 9.0), (1, 3), (4.0, 12.0), 0.8, 0.6, 0.5, parked),
        "terraces": Character(*wide, (1.5, 4.0), (2, 4), (0.0, 6.0), 0.5, 0.4, 0.7, parked),
        "village": Character(*wide, (2.0, 12.0), (1, 3), (6.0, 25.0), 0.9, 0.3, 0.4, parked),
    }
    return table[quarter]


class Plan(NamedTuple):
    """`kind` uint8 [Y,X] of GRASS ... KERBSTONE; `to_road_m` float32 [Y,X]; `origin` [2] world x, y
    of cell (0, 0).
    """

    kind: np.ndarray
    to_road_m: np.ndarray
    origin: np.ndarray
    # side (+1 left, -1 right) -> width for parked cars at the route's samples
    bays: dict[int, np.ndarray]
    parking: np.ndarray  # bool, whether cars may park at the route's samples

    def cells(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return rows and columns [...] of the nearest cells to points at x, y [...], clipped to
        the border.
        """
        row, column = (
            np.rint((along - origin) / CELL_M).astype(np.int64).clip(0, size - 1)
            for along, origin, size in zip((y, x), self.origin[::-1], self.kind.shape, strict=True)
        )
        return row, column

    def kerbs(self) -> list[np.ndarray]:
        """Return the closed outlines of the roads, each [N,2] in metres."""
        road = (self.to_road_m <= 0).astype(np.uint8)
        outlines, _ = cv2.findContours(road, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
        thinned = [cv2.approxPolyDP(outline, 0.7, True)[:, 0] for outline in outlines]
        return [outline * CELL_M + self.origin for outline in thinned if len(outline) > 2]


def draw_plan(route: Route, rng: np.random.Generator, character: Character) -> Plan:
    """Paint the road, its arms, pavements, parking bays and markings."""
    ends = [arm.xy + arm.length_m * unit(arm.heading_rad) for arm in route.arms]
    points = np.concatenate([route.xy, np.reshape(ends, (-1, 2))])
    origin = points.min(axis=0) - MARGIN_M
    width, height = np.ceil((points.max(axis=0) + MARGIN_M - origin) / CELL_M).astype(int)
    road = np.zeros((height, width), np.uint8)
    parking = _may_park(route, character.kerbside)
    bays = {side: _bay_width(route, parking, rng, character) for side in (1, -1)}
    s = route.s_m[_EVERY]
    left = route.at(s, route.edge_m(1) + bays[1][_EVERY])[0]
    right = route.at(s, route.edge_m(-1) - bays[-1][_EVERY])[0]
    _paint_band(road, left, right, origin, 1)
    for arm in route.arms:
        along = arm.xy + np.array([[0.0], [arm.length_m]]) * unit(arm.heading_rad)
        side = arm.half_m * unit(arm.heading_rad + np.pi / 2)
        _paint_band(road, along + side, along - side, origin, 1)
    road = _close(road, CORNER_M)

    to_road = (cv2.distanceTransform(1 - road, cv2.DIST_L2, 5) * CELL_M).astype(np.float32)
    kind = np.full(road.shape, GRASS, np.uint8)
    kind[to_road < character.pavement_m] = PAVEMENT
    kind[to_road < 0.25] = KERBSTONE
    kind[road > 0] = ASPHALT
    if not character.kerbside:
        paint = np.zeros_like(kind)
        _paint_markings(paint, route, bays, origin, rng)
        kind = np.where((paint > 0) & (road > 0), paint, kind)
    return Plan(kind, to_road, origin, bays, parking)


def _paint_markings(
    paint: np.ndarray,
    route: Route,
    bays: dict[int, np.ndarray],
    origin: np.ndarray,
    rng: np.random.Generator,
) -> None:
    """Paint bays, the line between the lanes, and in some drives lines along the edges."""
    s = route.s_m[_EVERY]
    for sign, edge in ((1, route.edge_m(1)), (-1, route.edge_m(-1))):
        _paint_band(
            paint,
            route.at(s, edge)[0],
            route.at(s, edge + sign * bays[sign][_EVERY])[0],
            origin,
            BAY,
        )
    clear = np.all(
        [np.abs(s - junction) > 11 for junction in route.junctions_m], axis=0
    ) | np.zeros(len(s), bool)
    for i in np.flatnonzero(clear[:-1] & ((s[:-1] % 5) < 2.5)):  # dashed: 2.5 m on, 2.5 m off
        _paint_line(paint, route.at(s[i : i + 2], route.centre_m)[0], origin)
    if rng.random() < 0.5:
        for i in np.flatnonzero(clear[:-1]):
            _paint_line(paint, route.at(s[i : i + 2], route.edge_m(-1) + 0.15)[0], origin)
            _paint_line(paint, route.at(s[i : i + 2], route.edge_m(1) - 0.15)[0], origin)


def _may_park(route: Route, kerbside: bool) -> np.ndarray:
    """Return bool [N]: not in sharp bends or at junctions; at kerbs closer to them than in bays."""
    bent_1pm, clearance_m = (0.085, 9.0) if kerbside else (0.055, 13.0)
    blocked = np.abs(route.curvature_1pm) > bent_1pm
    for junction in route.junctions_m:
        blocked |= np.abs(route.s_m - junction) < clearance_m
    reach = round(2 / STEP_M)
    return np.convolve(blocked, np.ones(2 * reach + 1), "same") == 0


def _bay_width(
    route: Route, parking: np.ndarray, rng: np.random.Generator, character: Character
) -> np.ndarray:
    """Draw the width for parked cars [N]: bays come in stretches; kerbs are free throughout."""
    width = np.full(len(route.s_m), BAY_M if character.kerbside else 0.0)
    if not character.kerbside and rng.random() < character.bays:
        start = route.s_m[0]
        while start < route.s_m[-1]:
            end = start + rng.uniform(20, 60)
            width[(route.s_m >= start) & (route.s_m < end)] = BAY_M
            start = end + rng.uniform(6, 20)
        width[~parking] = 0
    ramp = round(2 / STEP_M)
    return np.convolve(width, np.ones(ramp) / ramp, "same")


def _close(mask: np.ndarray, radius_m: float) -> np.ndarray:
    """Round the corners between roads by morphological closing with a disc."""
    grown = (cv2.distanceTransform(1 - mask, cv2.DIST_L2, 5) * CELL_M > radius_m).astype(np.uint8)
    closed = cv2.distanceTransform(1 - grown, cv2.DIST_L2, 5) * CELL_M > radius_m
    return (closed | (mask > 0)).astype(np.uint8)


def _paint_band(
    canvas: np.ndarray, left: np.ndarray, right: np.ndarray, origin: np.ndarray, value: int
) -> None:
    for i in range(len(left) - 1):
        quad = np.array([left[i], left[i + 1], right[i + 1], right[i]])
        cv2.fillConvexPoly(canvas, _fixed(quad, origin), value, shift=4)


def _paint_line(canvas: np.ndarray, ends: np.ndarray, origin: np.ndarray) -> None:
    a, b = _fixed(ends, origin)
    cv2.line(canvas, tuple(map(int, a)), tuple(map(int, b)), MARKING, 2, shift=4)


def _fixed(xy: np.ndarray, origin: np.ndarray) -> np.ndarray:
    """Convert world metres to OpenCV's fixed-point pixels with four fractional bits."""
    return np.rint((xy - origin) / CELL_M * 16).astype(np.int32)
