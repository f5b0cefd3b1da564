"""Draw moving cars: oncoming cars, and in some drives a car ahead of the ego."""

from typing import NamedTuple

import numpy as np

from pipeline.sample import shapes
from pipeline.sample.journey import Journey
from pipeline.sample.route import IMU_LEFT_M

# Distance in metres beyond which cars are not rendered.
SIGHT_M = 100.0
# Distance in metres along the road between the centres of two cars that do not touch.
_ROOM_ALONG_M = 4.5
# Distance in metres across the road between the centres of two cars that do not touch.
_ROOM_ACROSS_M = 2.4
# Distance in metres from the IMU, over the rear axle, to the centre of the ego.
_AXLE_TO_MIDDLE_M = 1.3
# Time in seconds by which the car ahead passes a place before the ego.
_LEAD_S = 2.5


class Vehicle(NamedTuple):
    """A car, and its pose in each of F frames."""

    shape: shapes.Mesh
    xy: np.ndarray  # [F,2]
    heading_rad: np.ndarray  # [F]
    visible: np.ndarray  # bool [F]

    def mesh_at(self, frame: int) -> shapes.Mesh:
        """Return the car's mesh at a frame."""
        return self.shape.moved_to(self.xy[frame], float(self.heading_rad[frame]))


def draw_traffic(journey: Journey, rng: np.random.Generator) -> list[Vehicle]:
    """Draw vehicles that follow the road's lanes for the entire drive."""
    vehicles = _draw_oncoming(journey, rng)
    if rng.random() < 0.35:
        vehicles.append(_draw_lead(journey, rng))
    return vehicles


def _draw_oncoming(journey: Journey, rng: np.random.Generator) -> list[Vehicle]:
    """Draw oncoming cars with distances of 40 to 110 m between them."""
    route = journey.route
    motion = journey.motion
    speed_mps = rng.uniform(5.0, 7.5)
    farthest_m = motion.s_m[-1] + speed_mps * motion.time_s[-1] + 60
    vehicles = []
    start_m = rng.uniform(25, 70)
    while start_m < farthest_m:
        s_m = start_m - speed_mps * motion.time_s
        on_road = (s_m > route.s_m[0] + 4) & (s_m < route.s_m[-1] - 4)
        if on_road.any():
            xy, heading_rad = route.place_at(s_m, route.centre_m + route.lane_m / 2)
            xy[~on_road] = route.xy[0] - 1e4  # out of sight
            car = shapes.build_car(rng)
            vehicles.append(Vehicle(car, xy, heading_rad + np.pi, _in_sight(xy, journey)))
        start_m += rng.uniform(40, 110)
    return vehicles


def _draw_lead(journey: Journey, rng: np.random.Generator) -> Vehicle:
    """Draw the car ahead, which drives as the ego will a few seconds later."""
    route = journey.route
    motion = journey.motion
    time_s = motion.time_s + _LEAD_S
    as_ego_m = np.interp(time_s, motion.time_s, motion.s_m, right=np.nan)

    # Beyond the ego's last place, the car drives on at the ego's last speed, but at least at 4 m/s.
    end_mps = max(float(motion.speed_mps[-1]), 4.0)
    beyond_m = motion.s_m[-1] + (time_s - motion.time_s[-1]) * end_mps
    s_m = np.where(np.isnan(as_ego_m), beyond_m, as_ego_m) + 6.0
    xy, heading_rad = route.place_at(s_m, route.centre_m - route.lane_m / 2)
    return Vehicle(shapes.build_car(rng), xy, heading_rad, _in_sight(xy, journey))


def _in_sight(xy: np.ndarray, journey: Journey) -> np.ndarray:
    """Return whether a vehicle at xy [F,2] is to be rendered in each frame, bool [F].

    In narrow streets, a vehicle might touch the ego. Then it is hidden for the entire encounter, so
    that it neither appears nor vanishes in view of the camera.
    """
    ego_xy, heading_rad = journey.route.place_at(journey.motion.s_m)
    offset = xy - ego_xy
    in_sight = np.linalg.norm(offset, axis=1) < SIGHT_M

    # The offset in the ego's own frame, from its centre.
    x, y = offset.T
    c = np.cos(heading_rad)
    s = np.sin(heading_rad)
    along_m = x * c + y * s - _AXLE_TO_MIDDLE_M
    across_m = y * c - x * s + IMU_LEFT_M
    touches = (np.abs(along_m) < _ROOM_ALONG_M) & (np.abs(across_m) < _ROOM_ACROSS_M)

    # Number the encounters, the runs of frames in sight. Frames out of sight have the number 0.
    encounter = np.cumsum(np.diff(in_sight, prepend=False)) * in_sight
    return in_sight & ~np.isin(encounter, encounter[touches & in_sight])
