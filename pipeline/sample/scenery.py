"""Build the static street: kerbs, barriers, houses, trees, posts, hedges, parked cars, woods."""

from typing import NamedTuple

import cv2
import numpy as np

from pipeline.camera import classes
from pipeline.sample import shapes
from pipeline.sample.plan import CELL_M, KERB_M, STOREY_M, Character, Plan
from pipeline.sample.route import LEFT, SIDES, Arm, Route, unit_vector
from pipeline.sample.shapes import Mesh, draw_colour

# Range of the distances in metres between a junction's edge and the barrier of a closed arm.
BARRIER_M = (2.0, 3.5)
# Distance in metres between two samples of a frontage.
_STEP_M = 0.5

# Albedo of kerbs, RGB in 0..1.
_STONE = (0.5, 0.5, 0.49)
# Albedo of the woods around the plan.
_WOODS = (0.13, 0.20, 0.10)
# Albedo of the red boards of a barrier.
_RED = (0.75, 0.08, 0.06)
# Albedo of the white boards of a barrier.
_WHITE = (0.9, 0.9, 0.88)
# Albedos of walls, of which a house has one.
_WALLS = np.array(
    [
        (0.62, 0.50, 0.38),
        (0.70, 0.66, 0.58),
        (0.55, 0.30, 0.24),
        (0.78, 0.76, 0.72),
        (0.48, 0.46, 0.44),
        (0.66, 0.56, 0.36),
        (0.42, 0.28, 0.24),
        (0.60, 0.62, 0.64),
    ]
)
# Albedos of roofs, of which a house has one.
_ROOFS = np.array([(0.38, 0.16, 0.12), (0.22, 0.20, 0.20), (0.30, 0.24, 0.22), (0.42, 0.24, 0.16)])


class Ground:
    """The plan, with a map of the cells on which objects stand."""

    def __init__(self, plan: Plan) -> None:
        self.plan = plan
        self._taken: np.ndarray = np.zeros(plan.kind.shape, bool)

    def claim_place(
        self, xy: np.ndarray, outward_rad: float, size: tuple[float, float], clear_m: float
    ) -> bool:
        """Occupy a rectangle around `xy` if it is free and at least `clear_m` from roads.

        `size` is its length along the street in metres, and its depth in the direction
        `outward_rad`. Returns whether it is occupied now.
        """
        length_m, depth_m = size
        along = unit_vector(outward_rad - np.pi / 2) * length_m / 2
        away = unit_vector(outward_rad) * depth_m / 2
        corners = np.array(
            [xy + along + away, xy - along + away, xy - along - away, xy + along - away]
        )

        # Only the cells in a window around the rectangle are examined.
        cells = np.rint((corners - self.plan.origin) / CELL_M).astype(np.int32)
        left, bottom = cells.min(axis=0)
        right, top = cells.max(axis=0) + 1
        rows, columns = self._taken.shape
        if left < 0 or bottom < 0 or right > columns or top > rows:
            return False
        window = (slice(bottom, top), slice(left, right))
        footprint = np.zeros((top - bottom, right - left), np.uint8)
        cv2.fillConvexPoly(footprint, cells - [left, bottom], 1)
        inside = footprint > 0

        taken = self._taken[window]
        to_road_m = self.plan.to_road_m[window]
        if taken[inside].any() or (to_road_m[inside] < clear_m).any():
            return False
        taken[inside] = True
        return True


class Frontage(NamedTuple):
    """A side of a road, sampled every half metre."""

    edge: np.ndarray  # [N,2], points of the road's edge
    outward_rad: np.ndarray  # [N], headings away from the road

    def point_behind(self, sample: int, distance_m: float) -> np.ndarray:
        """Return the point [2] at `distance_m` behind a sample of the edge."""
        return self.edge[sample] + distance_m * unit_vector(self.outward_rad[sample])


def build_street(route: Route, plan: Plan, character: Character, rng: np.random.Generator) -> Mesh:
    """Return the mesh of all static objects, without the ground."""
    parts = []
    for outline in plan.trace_kerbs():
        parts.append(shapes.build_wall(outline, KERB_M, _STONE, classes.SIDEWALK))
    parts.append(_build_woods(plan, rng))
    for arm in route.arms:
        if arm.closed:
            parts += _build_barrier(arm, route.lane_m, rng)
    for side in SIDES:
        parts += _park_cars(side, route, plan, character, rng)

    # Houses claim their places first, since they need the most space.
    ground = Ground(plan)
    sides = find_frontages(route, plan)
    for frontage in sides:
        parts += _build_houses(frontage, ground, character, rng)
    for frontage in sides:
        parts += _build_lamp_posts(frontage, ground, rng)
        parts += _build_gardens(frontage, ground, character, rng)
    parts += _build_backdrop(ground, character, rng)
    return shapes.merge_meshes(parts)


def _build_woods(plan: Plan, rng: np.random.Generator) -> Mesh:
    """Build a ring of woods around the plan, as a wall of 9 m with lumps and waves."""
    points = 160
    middle = plan.origin + plan.size_m / 2
    radius_m = np.linalg.norm(plan.size_m) / 2 + 25
    angle = np.arange(points) * 2 * np.pi / points
    lumps_m = 5 * rng.random(points)
    waves_m = 4 * np.sin(angle * 3 + rng.uniform(0, 6.28))
    ring = middle + radius_m * unit_vector(angle)
    return shapes.build_wall(ring, 9 + lumps_m + waves_m, _WOODS, classes.VEGETATION)


def _build_barrier(arm: Arm, lane_m: float, rng: np.random.Generator) -> list[Mesh]:
    """Build a barrier across a closed arm, of red and white boards of 0.7 m."""
    # The edge of the junction is as far from its centre as a lane is wide, and 0.25 m.
    middle = arm.place_at(lane_m + 0.25 + rng.uniform(*BARRIER_M))
    to_left = unit_vector(arm.heading_rad + np.pi / 2)
    boards = []
    for i, left_m in enumerate(np.arange(-arm.half_m + 0.35, arm.half_m, 0.7)):
        colour = _RED if i % 2 else _WHITE
        board = shapes.build_box((0.12, 0.7, 1.15), colour, classes.FENCE)
        boards.append(board.moved_to(middle + left_m * to_left, arm.heading_rad))
    return boards


def _build_houses(
    frontage: Frontage, ground: Ground, character: Character, rng: np.random.Generator
) -> list[Mesh]:
    """Build a row of houses. If a house does not fit, the row continues two metres farther."""
    quarter = character.quarter
    nearest_m, _ = quarter.setback_m
    clear_m = character.pavement_m + nearest_m * 0.6
    houses = []
    i = int(rng.integers(4))
    setback_m = rng.uniform(*quarter.setback_m)
    while i < len(frontage.edge):
        # The row has reached sample i. The middle of the house is half its length farther.
        length_m = rng.uniform(7, 15)
        depth_m = rng.uniform(7, 11)
        middle = min(i + int(length_m / 2 / _STEP_M), len(frontage.edge) - 1)
        outward_rad = frontage.outward_rad[middle]
        front_m = character.pavement_m + setback_m + rng.uniform(0, 0.8)
        xy = frontage.point_behind(middle, front_m + depth_m / 2)
        if not ground.claim_place(xy, outward_rad, (length_m, depth_m), clear_m=clear_m):
            i += 4
            continue

        colour = draw_colour(rng, _WALLS) * rng.uniform(0.85, 1.1)
        lowest, highest = quarter.storeys
        storeys = rng.integers(lowest, highest + 1)
        roof_m = 0.0 if storeys > 4 else rng.uniform(1.5, 3.5)
        height_m = STOREY_M * storeys + rng.uniform(0.2, 0.8)
        roof = draw_colour(rng, _ROOFS)
        house = shapes.build_house((length_m, depth_m, height_m), colour, roof, roof_m=roof_m)
        houses.append(house.moved_to(xy, outward_rad - np.pi / 2, KERB_M))

        # Most neighbours stand in line, at the same setback.
        i += int((length_m + rng.uniform(*quarter.gap_m)) / _STEP_M) + 1
        if rng.random() < 0.3:
            setback_m = rng.uniform(*quarter.setback_m)
    return houses


def _build_lamp_posts(frontage: Frontage, ground: Ground, rng: np.random.Generator) -> list[Mesh]:
    """Build lamp posts near the kerb, with distances of 19 to 28 m."""
    posts = []
    first = int(rng.integers(20))
    spacing = int(rng.integers(38, 56))
    for i in range(first, len(frontage.edge), spacing):
        xy = frontage.point_behind(i, 0.75)
        if ground.claim_place(xy, 0.0, (0.5, 0.5), clear_m=0.4):
            post = shapes.build_lamp_post(rng.uniform(5.5, 7.5))
            posts.append(post.moved_to(xy, frontage.outward_rad[i] + np.pi, KERB_M))
    return posts


def _build_gardens(
    frontage: Frontage, ground: Ground, character: Character, rng: np.random.Generator
) -> list[Mesh]:
    """Build hedges and fences behind the pavement, and trees."""
    quarter = character.quarter
    _, farthest_m = quarter.setback_m
    pavement_m = character.pavement_m
    parts = []
    for i in range(int(rng.integers(10)), len(frontage.edge), 9):
        outward_rad = frontage.outward_rad[i]
        if rng.random() < quarter.hedges:
            xy = frontage.point_behind(i, pavement_m + 0.5)
            if ground.claim_place(xy, outward_rad, (4.4, 0.7), clear_m=pavement_m):
                hedge = shapes.build_hedge(rng)
                parts.append(hedge.moved_to(xy, outward_rad - np.pi / 2, KERB_M))
        if rng.random() < quarter.trees * 0.5:
            # Trees stand in the pavement or, where houses are 2 m or more behind it, in gardens.
            behind_m = pavement_m - 0.5
            if farthest_m >= 2:
                behind_m = pavement_m + rng.uniform(1.5, 7)
            xy = frontage.point_behind(i, behind_m)
            if ground.claim_place(xy, 0.0, (1.2, 1.2), clear_m=min(behind_m - 0.7, pavement_m)):
                tree = shapes.build_tree(rng, height_m=rng.uniform(5, 9))
                parts.append(tree.moved_to(xy, rng.uniform(0, 6.28), KERB_M))
    return parts


def _build_backdrop(ground: Ground, character: Character, rng: np.random.Generator) -> list[Mesh]:
    """Build trees and houses behind the first row, so that its gaps are not empty."""
    _, highest = character.quarter.storeys
    size_m = ground.plan.size_m
    parts = []
    for _ in range(int(size_m.prod() / 90)):
        xy = ground.plan.origin + rng.uniform(0, 1, 2) * size_m
        heading_rad = rng.uniform(0, 6.28)
        if rng.random() < 0.25:
            length_m = rng.uniform(8, 16)
            depth_m = rng.uniform(8, 12)
            if ground.claim_place(xy, heading_rad, (length_m, depth_m), clear_m=16):
                colour = draw_colour(rng, _WALLS)
                height_m = STOREY_M * rng.integers(1, highest + 1) + 0.5
                roof = draw_colour(rng, _ROOFS)
                house = shapes.build_house((length_m, depth_m, height_m), colour, roof, roof_m=2.5)
                parts.append(house.moved_to(xy, heading_rad, KERB_M))
        elif ground.claim_place(xy, heading_rad, (3, 3), clear_m=character.pavement_m + 6):
            tree = shapes.build_tree(rng, height_m=rng.uniform(6, 12))
            parts.append(tree.moved_to(xy, heading_rad, KERB_M))
    return parts


def _park_cars(
    side: int, route: Route, plan: Plan, character: Character, rng: np.random.Generator
) -> list[Mesh]:
    """Build parked cars on a side of the route.

    They stand in bays or, in narrow streets, at the kerb. `plan.bays` has the width of the strip
    where they stand, in both cases.
    """
    cars = []
    s_m = route.s_m[0] + 3.0
    while s_m < route.s_m[-1] - 3:
        # A car needs the width of a bay for 2.7 m before and behind its middle.
        around = (route.s_m > s_m - 2.7) & (route.s_m < s_m + 2.7)
        has_room = plan.bays[side][around].min() > 2.0 and plan.parking[around].all()
        if has_room and rng.random() < character.parked:
            offset_m = route.edge_m(side) + side * (1.0 + rng.uniform(-0.1, 0.1))
            xy, heading_rad = route.place_at(s_m, offset_m)
            if side == LEFT:
                heading_rad = heading_rad + np.pi
            car = shapes.build_car(rng).moved_to(xy, float(heading_rad))
            # The car must not stand on another stretch of the road: no point of the route is nearer
            # than the one beside the car.
            if np.linalg.norm(route.xy - xy, axis=1).min() > abs(offset_m) - 0.2:
                cars.append(car)
        s_m += 5.6 + rng.uniform(0, 0.8)
    return cars


def find_frontages(route: Route, plan: Plan) -> list[Frontage]:
    """Return both sides of the route and its arms, and the far ends of the arms."""
    s_m = np.arange(route.s_m[0], route.s_m[-1], _STEP_M)
    sides = []
    for side in SIDES:
        bay_m = np.interp(s_m, route.s_m, plan.bays[side])
        edge, heading_rad = route.place_at(s_m, route.edge_m(side) + side * bay_m)
        sides.append(Frontage(edge, heading_rad + side * np.pi / 2))
    for arm in route.arms:
        # The sides of an arm begin 6 m from the centre of the junction, outside of it, and end as
        # far behind the arm's end, so that no gap is seen beside the houses that close it.
        along = arm.place_at(np.arange(6, arm.length_m + 6, _STEP_M))
        for side in SIDES:
            outward_rad = arm.heading_rad + side * np.pi / 2
            edge = along + arm.half_m * unit_vector(outward_rad)
            sides.append(Frontage(edge, np.full(len(edge), outward_rad)))
        # Houses close the arm's far end.
        across_m = np.arange(-12, 12, _STEP_M)[:, None]
        edge = arm.place_at(arm.length_m) + across_m * unit_vector(arm.heading_rad + np.pi / 2)
        sides.append(Frontage(edge, np.full(len(edge), arm.heading_rad)))
    return sides
