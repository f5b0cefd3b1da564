"""The ego's road in a drive, and its pose in every frame."""

from dataclasses import dataclass

import numpy as np

from pipeline.town.character import Character
from pipeline.town.manoeuvres import draw_route
from pipeline.town.motion import (
    IMU_HEIGHT_M,
    LATERAL_MPS2,
    Body,
    Motion,
    draw_body,
    draw_stops,
    drive,
    frame_times,
    speed_profile,
)
from pipeline.town.oxts import Recording, make_recording, oxts_rows
from pipeline.town.rig import rotation
from pipeline.town.route import AHEAD_M, Route

_WAIT_S = (0.8, 2.0)


@dataclass(frozen=True)
class Journey:
    """Positions xy [F,2] and headings heading_rad [F] of the IMU; `motion` is its place along the route."""

    route: Route
    motion: Motion
    body: Body
    xy: np.ndarray
    heading_rad: np.ndarray

    def pose(self, frame: int) -> np.ndarray:
        """Return T_world_imu [4,4]."""
        T = np.eye(4)
        T[:3, :3] = rotation(self.body.roll_rad[frame], self.body.pitch_rad[frame], self.heading_rad[frame])
        T[:3, 3] = *self.xy[frame], IMU_HEIGHT_M + self.body.heave_m[frame]
        return T


def draw_journey(rng: np.random.Generator, frames: int, character: Character, first: str) -> Journey:
    """Draw a road that begins with the manoeuvre `first`, and a drive of `frames` frames in its lane."""
    times = frame_times(rng, frames)
    cruise = rng.uniform(*character.cruise_mps)
    route = draw_route(rng, cruise * times[-1] + AHEAD_M, character.lane_m, first)
    speed = speed_profile(route, cruise, rng.uniform(*LATERAL_MPS2), draw_stops(rng, route, 0.75 * cruise * times[-1]))
    motion = drive(route, speed, times, rng.uniform(*_WAIT_S))
    return Journey(route, motion, draw_body(route, motion, rng), *route.at(motion.s_m))


def record(journey: Journey, date: str, rng: np.random.Generator) -> Recording:
    """Return the oxts files of a drawn drive, at a random place and time of day."""
    rows = oxts_rows(journey.route, journey.motion, journey.body, *rng.uniform((48.9, 8.3), (49.1, 8.5)))
    return make_recording(rows, journey.motion.time_s, date, start_s=rng.uniform(8, 17) * 3600)
