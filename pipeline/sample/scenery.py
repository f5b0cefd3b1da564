"""Build the static street: kerbs, barriers, houses, trees, posts, hedges, parked cars, woods on the
horizon.
"""

from typing import NamedTuple

import cv2
import numpy as np

from pipeline.camera import classes
from pipeline.sample import shapes
from pipeline.sample.plan import CELL_M, KERB_M, Character, Plan
from pipeline.sample.route import LEFT, RIGHT, Route, unit
from pipeline.sample.shapes import Mesh

BARRIER_M = (2.0, 3.5)  # from the junction's edge to the barrier of a closed arm
_WALLS = [
    (0.62, 0.50, 0.38),
    (0.70, 0.66, 0.58),
    (0.55, 0.30, 0.24),
    (0.78, 0.76, 0.72),
    (0.48, 0.46, 0.44),
    (0.66, 0.56, 0.36),
    (0.42, 0.28, 0.24),
    (0.60, 0.62, 0.64),
]
_ROOFS = [(0.38, 0.16, 0.12), (0.22, 0.20, 0.20), (0.30, 0.24, 0.22), (0.42, 0.24, 0.16)]
_LEAVES = [(0.16, 0.30, 0.08), (0.22, 0.34, 0.10), (0.12, 0.24, 0.10), (0.30, 0.34, 0.12)]


class Ground:
    """The plan, with a map of occupied cells."""

    def __init__(self, plan: Plan) -> None:
        self.plan = plan
        self._taken: np.ndarray = np.zeros(plan.kind.shape, np.uint8)

    def claim(
        self, xy: np.ndarray, outward_rad: float, size: tuple[float, float], clear_m: float
    ) -> bool:
        """Take a rectangle of `size` (along the street, away from it) if it is free and keeps
        `clear_m` from roads.
        """
        along, away = unit(outward_rad - np.pi / 2) * size[0] / 2, unit(outward_rad) * size[1] / 2
        corners = np.array(
            [xy + along + away, xy - along + away, xy - along - away, xy + along - away]
        )
        cells = np.rint((corners - self.plan.origin) / CELL_M).astype(np.int32)
        lowest, highest = cells.min(axis=0), cells.max(axis=0) + 1
        if (
            (lowest < 0).any()
            or highest[0] > self._taken.shape[1]
            or highest[1] > self._taken.shape[0]
        ):
            return False
        window = (slice(lowest[1], highest[1]), slice(lowest[0], highest[0]))
        footprint = np.zeros(self._taken[window].shape, np.uint8)
        cv2.fillConvexPoly(footprint, cells - lowest, 1)
        inside = footprint > 0
        if (self._taken[window][inside] > 0).any() or (
            self.plan.to_road_m[window][inside] < clear_m
        ).any():
            return False
        self._taken[window][inside] = 1
        return True


class Frontage(NamedTuple):
    """One side of a road: the line of its edge, [N,2] every half metre, and the outward headings
    [N].
    """

    edge: np.ndarray
    outward_rad: np.ndarray


def build_street(route: Route, plan: Plan, character: Character, rng: np.random.Generator) -> Mesh:
    """Return the mesh of all static objects, without the ground."""
    ground = Ground(plan)
    parts = [
        shapes.wall(outline, KERB_M, (0.5, 0.5, 0.49), classes.SIDEWALK) for outline in plan.kerbs()
    ]
    parts += [_horizon(plan, rng), *_barriers(route, rng)]
    parts += _parked_cars(route, plan, character, rng)
    for frontage in frontages(route, plan):
        parts += _houses(frontage, ground, character, rng)
    for frontage in frontages(route, plan):
        parts += _furniture(frontage, ground, character, rng)
    parts += _backdrop(ground, character, rng)
    return shapes.merge(parts)


def _horizon(plan: Plan, rng: np.random.Generator) -> Mesh:
    """Build a ring of woods around the sample."""
    size = plan.size_m
    middle, radius, n = plan.origin + size / 2, np.linalg.norm(size) / 2 + 25, 160
    angle = np.arange(n) * 2 * np.pi / n
    ring = middle + radius * unit(angle)
    heights = 9 + 5 * rng.random(n) + 4 * np.sin(angle * 3 + rng.uniform(0, 6.28))
    return shapes.wall(ring, heights, (0.13, 0.20, 0.10), classes.VEGETATION)


def _barriers(route: Route, rng: np.random.Generator) -> list[Mesh]:
    """Build red and white boards across closed arms, just beyond the junction."""
    parts = []
    for arm in route.arms:
        if not arm.closed:
            continue
        middle = arm.xy + (route.lane_m + 0.25 + rng.uniform(*BARRIER_M)) * unit(arm.heading_rad)
        boards = np.arange(-arm.half_m + 0.35, arm.half_m, 0.7)
        for i, across in enumerate(boards):
            colour = (0.75, 0.08, 0.06) if i % 2 else (0.9, 0.9, 0.88)
            xy = middle + across * unit(arm.heading_rad + np.pi / 2)
            parts.append(
                shapes.box((0.12, 0.7, 1.15), colour, classes.FENCE).placed(xy, arm.heading_rad)
            )
    return parts


def _houses(
    frontage: Frontage, ground: Ground, character: Character, rng: np.random.Generator
) -> list[Mesh]:
    parts, i = [], int(rng.integers(4))
    setback = rng.uniform(*character.quarter.setback_m)
    while i < len(frontage.edge):
        length, depth = rng.uniform(7, 15), rng.uniform(7, 11)
        middle = min(i + int(length), len(frontage.edge) - 1)  # half the length in half-metre steps
        outward = frontage.outward_rad[middle]
        back = character.pavement_m + setback + rng.uniform(0, 0.8) + depth / 2
        xy = frontage.edge[middle] + back * unit(outward)
        if ground.claim(
            xy,
            outward,
            (length, depth),
            character.pavement_m + character.quarter.setback_m[0] * 0.6,
        ):
            wall = np.array(_WALLS[rng.integers(len(_WALLS))]) * rng.uniform(0.85, 1.1)
            storeys = rng.integers(character.quarter.storeys[0], character.quarter.storeys[1] + 1)
            roof_m = 0.0 if storeys > 4 else rng.uniform(1.5, 3.5)
            size = (length, depth, 2.9 * storeys + rng.uniform(0.2, 0.8))
            house = shapes.house(size, tuple(wall), _ROOFS[rng.integers(len(_ROOFS))], roof_m)
            parts.append(house.placed(xy, outward - np.pi / 2, KERB_M))
            i += int(2 * (length + rng.uniform(*character.quarter.gap_m))) + 1
            if rng.random() < 0.3:
                setback = rng.uniform(*character.quarter.setback_m)
        else:
            i += 4
    return parts


def _furniture(
    frontage: Frontage, ground: Ground, character: Character, rng: np.random.Generator
) -> list[Mesh]:
    parts: list[Mesh] = []
    clear = character.pavement_m
    # lamp posts near the kerb
    for i in range(int(rng.integers(20)), len(frontage.edge), int(rng.integers(38, 56))):
        xy = frontage.edge[i] + 0.75 * unit(frontage.outward_rad[i])
        if ground.claim(xy, 0.0, (0.5, 0.5), 0.4):
            post = shapes.lamp_post(rng.uniform(5.5, 7.5))
            parts.append(post.placed(xy, frontage.outward_rad[i] + np.pi, KERB_M))
    for i in range(int(rng.integers(10)), len(frontage.edge), 9):
        outward = frontage.outward_rad[i]
        if rng.random() < character.quarter.hedges:
            xy = frontage.edge[i] + (clear + 0.5) * unit(outward)
            if ground.claim(xy, outward, (4.4, 0.7), clear):
                parts.append(_hedge(rng).placed(xy, outward - np.pi / 2, KERB_M))
        if rng.random() < character.quarter.trees * 0.5:
            # Street trees stand in the pavement, garden trees behind it.
            back = (
                clear - 0.5 if character.quarter.setback_m[1] < 2 else clear + rng.uniform(1.5, 7)
            )
            xy = frontage.edge[i] + back * unit(outward)
            if ground.claim(xy, 0.0, (1.2, 1.2), min(back - 0.7, clear)):
                parts.append(
                    shapes.tree(rng, rng.uniform(5, 9), _leaves(rng)).placed(
                        xy, rng.uniform(0, 6.28), KERB_M
                    )
                )
    return parts


def _backdrop(ground: Ground, character: Character, rng: np.random.Generator) -> list[Mesh]:
    """Build trees and houses behind the first row, so that its gaps are not empty."""
    parts = []
    size = ground.plan.size_m
    for _ in range(int(size.prod() / 90)):
        xy = ground.plan.origin + rng.uniform(0, 1, 2) * size
        heading = rng.uniform(0, 6.28)
        if rng.random() < 0.25:
            dims = (rng.uniform(8, 16), rng.uniform(8, 12))
            if ground.claim(xy, heading, dims, 16):
                wall = _WALLS[rng.integers(len(_WALLS))]
                height = 2.9 * rng.integers(1, character.quarter.storeys[1] + 1) + 0.5
                house = shapes.house((*dims, height), wall, _ROOFS[rng.integers(len(_ROOFS))], 2.5)
                parts.append(house.placed(xy, heading, KERB_M))
        elif ground.claim(xy, heading, (3, 3), character.pavement_m + 6):
            parts.append(
                shapes.tree(rng, rng.uniform(6, 12), _leaves(rng)).placed(xy, heading, KERB_M)
            )
    return parts


def _parked_cars(
    route: Route, plan: Plan, character: Character, rng: np.random.Generator
) -> list[Mesh]:
    parts = []
    for side, edge in ((1, route.edge_m(LEFT)), (-1, route.edge_m(RIGHT))):
        s = route.s_m[0] + 3.0
        while s < route.s_m[-1] - 3:
            around = (route.s_m > s - 2.7) & (route.s_m < s + 2.7)
            room = plan.bays[side][around].min() > 2.0 and plan.parking[around].all()
            if room and rng.random() < character.parked:
                offset = edge + side * (1.0 + rng.uniform(-0.1, 0.1))
                xy, heading = route.at(s, offset)
                car = shapes.car(rng).placed(xy, float(heading) + (np.pi if side > 0 else 0))
                # clear of other stretches
                if np.linalg.norm(route.xy - xy, axis=1).min() > abs(offset) - 0.2:
                    parts.append(car)
            s += 5.6 + rng.uniform(0, 0.8)
    return parts


def _hedge(rng: np.random.Generator) -> Mesh:
    """Build a hedge or a wooden fence."""
    if rng.random() < 0.5:
        return shapes.box((4.5, 0.7, rng.uniform(0.9, 1.5)), _leaves(rng), classes.VEGETATION)
    brown = tuple(np.array([0.42, 0.28, 0.16]) * rng.uniform(0.8, 1.2))
    return shapes.box((4.5, 0.1, rng.uniform(1.0, 1.4)), brown, classes.FENCE)


def _leaves(rng: np.random.Generator) -> shapes.Colour:
    return tuple(np.array(_LEAVES[rng.integers(len(_LEAVES))]) * rng.uniform(0.8, 1.2))


def frontages(route: Route, plan: Plan) -> list[Frontage]:
    """Return both sides of the route and its arms, and the far ends of the arms."""
    s = np.arange(route.s_m[0], route.s_m[-1], 0.5)
    sides = []
    for side, edge in ((1, route.edge_m(LEFT)), (-1, route.edge_m(RIGHT))):
        bay = np.interp(s, route.s_m, plan.bays[side])
        xy, heading = route.at(s, edge + side * bay)
        sides.append(Frontage(xy, heading + side * np.pi / 2))
    for arm in route.arms:
        along = np.arange(6, arm.length_m + 6, 0.5)[:, None] * unit(arm.heading_rad)
        for side in (1, -1):
            outward = arm.heading_rad + side * np.pi / 2
            xy = arm.xy + along + arm.half_m * unit(outward)
            sides.append(Frontage(xy, np.full(len(xy), outward)))
        # closes the arm's far end
        across = np.arange(-12, 12, 0.5)[:, None] * unit(arm.heading_rad + np.pi / 2)
        xy = arm.xy + arm.length_m * unit(arm.heading_rad) + across
        sides.append(Frontage(xy, np.full(len(xy), arm.heading_rad)))
    return sides
