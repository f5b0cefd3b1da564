"""Find free ground beside the road."""

from dataclasses import dataclass

import cv2
import numpy as np

from pipeline.town.plan import CELL_M, Plan
from pipeline.town.route import Route, unit


class Ground:
    """The plan, with a map of occupied cells."""

    def __init__(self, plan: Plan) -> None:
        self.plan = plan
        self._taken: np.ndarray = np.zeros(plan.kind.shape, np.uint8)

    def claim(self, corners: np.ndarray, clear_m: float) -> bool:
        """Take the convex footprint `corners` [N,2] if it is free and keeps `clear_m` from roads."""
        cells = np.rint((corners - self.plan.origin) / CELL_M).astype(np.int32)
        lowest, highest = cells.min(axis=0), cells.max(axis=0) + 1
        if (lowest < 0).any() or highest[0] > self._taken.shape[1] or highest[1] > self._taken.shape[0]:
            return False
        window = (slice(lowest[1], highest[1]), slice(lowest[0], highest[0]))
        footprint = np.zeros(self._taken[window].shape, np.uint8)
        cv2.fillConvexPoly(footprint, cells - lowest, 1)
        inside = footprint > 0
        if (self._taken[window][inside] > 0).any() or (self.plan.to_road_m[window][inside] < clear_m).any():
            return False
        self._taken[window][inside] = 1
        return True


@dataclass(frozen=True)
class Frontage:
    """One side of a road: the line of its edge, [N,2] every half metre, and the outward headings [N]."""

    edge: np.ndarray
    outward_rad: np.ndarray


def frontages(route: Route, plan: Plan) -> list[Frontage]:
    """Return both sides of the route and its arms, and the far ends of the arms."""
    s = np.arange(route.s_m[0], route.s_m[-1], 0.5)
    sides = []
    for side, edge in ((1, route.left_m), (-1, route.right_m)):
        bay = np.interp(s, route.s_m, plan.bays[side])
        xy, heading = route.at(s, edge + side * bay)
        sides.append(Frontage(xy, heading + side * np.pi / 2))
    for arm in route.arms:
        along = np.arange(6, arm.length_m + 6, 0.5)[:, None] * unit(arm.heading_rad)
        for side in (1, -1):
            outward = arm.heading_rad + side * np.pi / 2
            xy = arm.xy + along + arm.half_m * unit(outward)
            sides.append(Frontage(xy, np.full(len(xy), outward)))
        across = np.arange(-12, 12, 0.5)[:, None] * unit(arm.heading_rad + np.pi / 2)  # closes the arm's far end
        xy = arm.xy + arm.length_m * unit(arm.heading_rad) + across
        sides.append(Frontage(xy, np.full(len(xy), arm.heading_rad)))
    return sides


def footprint(xy: np.ndarray, outward_rad: float, size: tuple[float, float]) -> np.ndarray:
    """Return the corners [4,2] of a rectangle of `size` (along the street, away from it)."""
    along, away = unit(outward_rad - np.pi / 2) * size[0] / 2, unit(outward_rad) * size[1] / 2
    return np.array([xy + along + away, xy - along + away, xy - along - away, xy + along - away])
