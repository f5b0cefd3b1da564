"""How the ego moves along its path: where it is at which time, and how fast."""

from dataclasses import dataclass

import numpy as np

from pipeline.town.route import STEP_M, Route

PERIOD_S = 0.1036  # KITTI's synchronised stream
JITTER_S = 0.001
IMU_HEIGHT_M = 0.93
ACCELERATE_MPS2, BRAKE_MPS2 = 1.8, 2.2
LATERAL_MPS2 = (1.5, 3.2)  # of one driver and another


@dataclass(frozen=True)
class Motion:
    """The ego per frame: time_s, s_m (along the route), speed_mps, acceleration_mps2, all [F]."""

    time_s: np.ndarray
    s_m: np.ndarray
    speed_mps: np.ndarray
    acceleration_mps2: np.ndarray


def frame_times(rng: np.random.Generator, frames: int) -> np.ndarray:
    """Return seconds since the first frame [F], ascending, with a recorder's jitter."""
    times = np.arange(frames) * PERIOD_S + rng.uniform(-JITTER_S, JITTER_S, frames)
    return times - times[0]


def speed_profile(route: Route, cruise_mps: float, lateral_mps2: float, stops_m: tuple[float, ...] = ()) -> np.ndarray:
    """Return the speed at each of the route's samples [N]: in bends no more than `lateral_mps2`, zero at `stops_m`."""
    curvature = np.maximum(np.abs(route.curvature_1pm), 1e-6)
    speed = np.minimum(cruise_mps, np.sqrt(lateral_mps2 / curvature))
    speed[[round((stop - route.s_m[0]) / STEP_M) for stop in stops_m]] = 0.0
    for i in range(1, len(speed)):
        speed[i] = min(speed[i], np.sqrt(speed[i - 1] ** 2 + 2 * ACCELERATE_MPS2 * STEP_M))
    for i in range(len(speed) - 2, -1, -1):
        speed[i] = min(speed[i], np.sqrt(speed[i + 1] ** 2 + 2 * BRAKE_MPS2 * STEP_M))
    return speed


def draw_stops(rng: np.random.Generator, route: Route, before_m: float) -> tuple[float, ...]:
    """Return where the ego halts for a moment: in some drives, ahead of a junction that lies before `before_m`."""
    places = [junction - 13.0 for junction in route.junctions_m if 15 < junction - 13 < before_m]
    return (places[int(rng.integers(len(places)))],) if places and rng.random() < 0.2 else ()


def drive(route: Route, speed_mps: np.ndarray, times_s: np.ndarray, wait_s: float) -> Motion:
    """Follow `speed_mps` [N] along the route from s = 0; where it is zero, stand for `wait_s`.

    The acceleration is constant between samples of the route, so position and speed are each other's exact integral.
    """
    start = round(-route.s_m[0] / STEP_M)
    s, v = route.s_m[start:], speed_mps[start:]
    stop = np.flatnonzero(v == 0)
    s, v = np.insert(s, stop, s[stop]), np.insert(v, stop, 0.0)  # two knots per stop: arrival and departure
    ds, both = np.diff(s), v[1:] + v[:-1]
    duration = np.where(both > 0, 2 * ds / np.where(both > 0, both, 1.0), wait_s)
    knots = np.concatenate([[0.0], np.cumsum(duration)])
    if times_s[-1] >= knots[-1]:
        raise ValueError("the route is too short for the drive")
    i = np.searchsorted(knots, times_s, side="right") - 1
    acceleration = np.diff(v)[i] / duration[i]
    t = times_s - knots[i]
    return Motion(times_s, s[i] + v[i] * t + acceleration * t**2 / 2, v[i] + acceleration * t, acceleration)
