"""What the ego does in a drive: the road that it follows, and where it is in every frame."""

from dataclasses import dataclass

import numpy as np

from pipeline.town.motion import Motion, draw_stops, drive, frame_times, oxts_rows, speed_profile
from pipeline.town.recording import Recording, make_recording
from pipeline.town.route import AHEAD_M, Route, draw_route

_CRUISE_MPS = (7.0, 10.0)


@dataclass(frozen=True)
class Journey:
    """The IMU is at xy [F,2] and the car points to heading_rad [F]; `motion` is its place along the route."""

    route: Route
    motion: Motion
    xy: np.ndarray
    heading_rad: np.ndarray


def draw_journey(rng: np.random.Generator, frames: int) -> Journey:
    """Draw a road and a drive of `frames` frames along it, which keeps exactly to its lane."""
    times = frame_times(rng, frames)
    cruise = rng.uniform(*_CRUISE_MPS)
    route = draw_route(rng, cruise * times[-1] + AHEAD_M)
    stops = draw_stops(rng, route, 0.75 * cruise * times[-1])
    motion = drive(route, speed_profile(route, cruise, stops), times, rng.uniform(1.5, 3.0))
    return Journey(route, motion, *route.at(motion.s_m))


def record(journey: Journey, date: str, rng: np.random.Generator) -> Recording:
    """Return the oxts files of a drawn drive, at a place and time of day drawn at random."""
    rows = oxts_rows(journey.route, journey.motion, *rng.uniform((48.9, 8.3), (49.1, 8.5)))
    return make_recording(rows, journey.motion.time_s, date, start_s=rng.uniform(8, 17) * 3600)
