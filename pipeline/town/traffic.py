"""Cars that move: oncoming ones, and sometimes one ahead."""

from dataclasses import dataclass

import numpy as np

from pipeline.town import shapes
from pipeline.town.motion import Motion
from pipeline.town.route import Route
from pipeline.town.shapes import Mesh


@dataclass(frozen=True)
class Vehicle:
    """A car and its place per frame: xy [F,2], heading_rad [F]."""

    shape: Mesh
    xy: np.ndarray
    heading_rad: np.ndarray

    def at(self, frame: int) -> Mesh:
        return self.shape.placed(self.xy[frame], float(self.heading_rad[frame]))


def draw_traffic(route: Route, motion: Motion, rng: np.random.Generator) -> list[Vehicle]:
    """Draw vehicles that follow the road's lanes for the whole drive. Oncoming ones appear every 40 to 110 m."""
    vehicles = []
    speed = rng.uniform(5.0, 7.5)
    covered = motion.s_m[-1] + speed * motion.time_s[-1] + 60
    start = rng.uniform(25, 70)
    while start < covered:
        s = start - speed * motion.time_s
        on_road = (s > route.s_m[0] + 4) & (s < route.s_m[-1] - 4)
        if on_road.any():
            xy, heading = route.at(s, route.centre_m + route.lane_m / 2)
            xy[~on_road] = route.xy[0] - 1e4  # out of sight
            vehicles.append(Vehicle(shapes.car(rng), xy, heading + np.pi))
        start += rng.uniform(40, 110)
    if rng.random() < 0.35:
        # The car ahead did what the ego does a few seconds earlier; towards the drive's end it pulls away.
        lead_s = np.interp(motion.time_s + 2.5, motion.time_s, motion.s_m, right=np.nan)
        beyond = motion.s_m[-1] + (motion.time_s + 2.5 - motion.time_s[-1]) * max(float(motion.speed_mps[-1]), 4.0)
        xy, heading = route.at(np.where(np.isnan(lead_s), beyond, lead_s) + 6.0, route.centre_m - route.lane_m / 2)
        vehicles.append(Vehicle(shapes.car(rng), xy, heading))
    return vehicles
