"""Draw moving cars: oncoming ones, and sometimes one ahead."""

from typing import NamedTuple

import numpy as np

from pipeline.sample import shapes
from pipeline.sample.journey import Journey
from pipeline.sample.route import IMU_LEFT_M

SIGHT_M = 100.0  # farther cars are not rendered
_ROOM_M = (4.5, 2.4)  # between the centres of two cars, along and across
_AXLE_TO_MIDDLE_M = 1.3  # the IMU is over the rear axle


class Vehicle(NamedTuple):
    """A car, its pose per frame, xy [F,2] and heading_rad [F], and whether it is in sight, bool
    [F].
    """

    shape: shapes.Mesh
    xy: np.ndarray
    heading_rad: np.ndarray
    visible: np.ndarray

    def at(self, frame: int) -> shapes.Mesh:
        """Return the car's mesh at a frame."""
        return self.shape.placed(self.xy[frame], float(self.heading_rad[frame]))


def draw_traffic(journey: Journey, rng: np.random.Generator) -> list[Vehicle]:
    """Draw vehicles that follow the road's lanes for the entire drive. Oncoming ones appear every
    40 to 110 m.
    """
    vehicles, route, motion = [], journey.route, journey.motion
    speed = rng.uniform(5.0, 7.5)
    covered = motion.s_m[-1] + speed * motion.time_s[-1] + 60
    start = rng.uniform(25, 70)
    while start < covered:
        s = start - speed * motion.time_s
        on_road = (s > route.s_m[0] + 4) & (s < route.s_m[-1] - 4)
        if on_road.any():
            xy, heading = route.at(s, route.centre_m + route.lane_m / 2)
            xy[~on_road] = route.xy[0] - 1e4  # out of sight
            vehicles.append(Vehicle(shapes.car(rng), xy, heading + np.pi, _in_sight(xy, journey)))
        start += rng.uniform(40, 110)
    if rng.random() < 0.35:
        # The car ahead is the ego a few seconds earlier; towards the drive's end it pulls away.
        lead_s = np.interp(motion.time_s + 2.5, motion.time_s, motion.s_m, right=np.nan)
        beyond = motion.s_m[-1] + (motion.time_s + 2.5 - motion.time_s[-1]) * max(
            float(motion.speed_mps[-1]), 4.0
        )
        xy, heading = route.at(
            np.where(np.isnan(lead_s), beyond, lead_s) + 6.0, route.centre_m - route.lane_m / 2
        )
        vehicles.append(Vehicle(shapes.car(rng), xy, heading, _in_sight(xy, journey)))
    return vehicles


def _in_sight(xy: np.ndarray, journey: Journey) -> np.ndarray:
    """Return bool [F]: a vehicle at xy [F,2] is in sight.

    In narrow streets, a vehicle might touch the ego. It is then hidden for the entire encounter, so
    that it neither appears nor vanishes in sight.
    """
    ego, heading_rad = journey.route.at(journey.motion.s_m)
    to = xy - ego
    in_sight = np.linalg.norm(to, axis=1) < SIGHT_M
    c, s = np.cos(heading_rad), np.sin(heading_rad)
    along, across = (
        to[:, 0] * c + to[:, 1] * s - _AXLE_TO_MIDDLE_M,
        to[:, 1] * c - to[:, 0] * s + IMU_LEFT_M,
    )
    touches = (np.abs(along) < _ROOM_M[0]) & (np.abs(across) < _ROOM_M[1])
    encounter = np.cumsum(np.diff(in_sight, prepend=False)) * in_sight  # numbered; 0: out of sight
    return in_sight & ~np.isin(encounter, encounter[touches & in_sight])
