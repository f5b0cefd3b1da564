"""Move the ego along its route over time, and its body on its springs: its pose in every frame."""

from typing import NamedTuple

import numpy as np

from pipeline.camera.geometry import rigid
from pipeline.sample.plan import Character
from pipeline.sample.route import AHEAD_M, IMU_HEIGHT_M, STEP_M, Route, draw_route, rotation

PERIOD_S = 0.1036  # KITTI's synchronised stream
JITTER_S = 0.001
# recorded by oxts after the last image: most drive on for 30 m, the path ahead of the last images
FRAMES_AFTER = 45
ACCELERATE_MPS2, BRAKE_MPS2 = 1.8, 2.2
LATERAL_MPS2 = (1.5, 3.2)  # range over drivers
_WAIT_S = (0.8, 2.0)  # of a stop

_LEAN_RAD_PER_MPS2, _DIVE_RAD_PER_MPS2 = 0.004, 0.003
# range of a drive's standard deviation
_BUMPS_RAD, _BUMPS_M = np.deg2rad((0.03, 0.2)), (0.002, 0.012)
_BUMP_M = 2.0  # half the length of a bump along the road
_SPRING_FRAMES = 5  # response of the body to a step of the acceleration
_GRID_M = 0.25


class Travel(NamedTuple):
    """The ego's progress per frame: time_s, s_m (along the route), speed_mps, acceleration_mps2,
    all [F].
    """

    time_s: np.ndarray
    s_m: np.ndarray
    speed_mps: np.ndarray
    acceleration_mps2: np.ndarray


class Body(NamedTuple):
    """Per frame [F]: roll_rad (positive: left side up), pitch_rad (positive: front down), as in
    oxts; heave_m.
    """

    roll_rad: np.ndarray
    pitch_rad: np.ndarray
    heave_m: np.ndarray


class Journey(NamedTuple):
    """The IMU's `motion` along the route for F frames, and how it continues `after` them for
    FRAMES_AFTER frames.
    """

    route: Route
    motion: Travel
    after: Travel
    body: Body

    def continued(self) -> "Journey":
        """Return the journey with the frames `after`, on which the body leans as in the last
        frame.
        """
        motion = Travel(*map(np.concatenate, zip(self.motion, self.after, strict=True)))
        body = Body(*(np.pad(lean, (0, len(self.after.s_m)), mode="edge") for lean in self.body))
        return Journey(self.route, motion, self.after, body)

    def pose(self, frame: int) -> np.ndarray:
        """Return T_world_imu [4,4]."""
        xy, heading_rad = self.route.at(self.motion.s_m[frame])
        R = rotation(self.body.roll_rad[frame], self.body.pitch_rad[frame], float(heading_rad))
        return rigid(R, [*xy, IMU_HEIGHT_M + self.body.heave_m[frame]])


def draw_journey(
    rng: np.random.Generator, frames: int, character: Character, first: str
) -> Journey:
    """Draw a road that begins with the manoeuvre `first`, and a drive of `frames` frames in its
    lane.
    """
    times = frame_times(rng, frames)
    cruise = rng.uniform(*character.quarter.cruise_mps)
    route = draw_route(rng, cruise * times[-1] + AHEAD_M, character.lane_m, first)
    speed = speed_profile(
        route, cruise, rng.uniform(*LATERAL_MPS2), draw_stops(rng, route, 0.75 * cruise * times[-1])
    )
    wait_s = rng.uniform(*_WAIT_S)
    motion = drive(route, speed, times, wait_s)
    after = drive(route, speed, times[-1] + PERIOD_S * np.arange(1, FRAMES_AFTER + 1), wait_s)
    return Journey(route, motion, after, draw_body(route, motion, rng))


def frame_times(rng: np.random.Generator, frames: int) -> np.ndarray:
    """Draw frame times [F] in seconds since the first frame, ascending, with jitter."""
    times = np.arange(frames) * PERIOD_S + rng.uniform(-JITTER_S, JITTER_S, frames)
    return times - times[0]


def speed_profile(
    route: Route, cruise_mps: float, lateral_mps2: float, stops_m: tuple[float, ...] = ()
) -> np.ndarray:
    """Return the speed at the route's samples [N], limited by `lateral_mps2` in bends, zero at
    `stops_m`.
    """
    curvature = np.maximum(np.abs(route.curvature_1pm), 1e-6)
    speed = np.minimum(cruise_mps, np.sqrt(lateral_mps2 / curvature))
    speed[[round((stop - route.s_m[0]) / STEP_M) for stop in stops_m]] = 0.0
    for i in range(1, len(speed)):
        speed[i] = min(speed[i], np.sqrt(speed[i - 1] ** 2 + 2 * ACCELERATE_MPS2 * STEP_M))
    for i in range(len(speed) - 2, -1, -1):
        speed[i] = min(speed[i], np.sqrt(speed[i + 1] ** 2 + 2 * BRAKE_MPS2 * STEP_M))
    return speed


def draw_stops(rng: np.random.Generator, route: Route, before_m: float) -> tuple[float, ...]:
    """Draw the places where the ego halts: in some drives, ahead of a junction before
    `before_m`.
    """
    places = [junction - 13.0 for junction in route.junctions_m if 15 < junction - 13 < before_m]
    return (places[int(rng.integers(len(places)))],) if places and rng.random() < 0.2 else ()


def drive(route: Route, speed_mps: np.ndarray, times_s: np.ndarray, wait_s: float) -> Travel:
    """Follow `speed_mps` [N] along the route from s = 0; wait for `wait_s` where it is zero.

    Acceleration is constant between samples of the route, so that positions integrate speeds
    exactly.
    """
    start = round(-route.s_m[0] / STEP_M)
    s, v = route.s_m[start:], speed_mps[start:]
    stop = np.flatnonzero(v == 0)
    # two knots per stop: arrival and departure
    s, v = np.insert(s, stop, s[stop]), np.insert(v, stop, 0.0)
    ds, both = np.diff(s), v[1:] + v[:-1]
    duration = np.where(both > 0, 2 * ds / np.where(both > 0, both, 1.0), wait_s)
    knots = np.concatenate([[0.0], np.cumsum(duration)])
    i = np.searchsorted(knots, times_s, side="right") - 1
    acceleration = np.diff(v)[i] / duration[i]
    t = times_s - knots[i]
    return Travel(
        times_s, s[i] + v[i] * t + acceleration * t**2 / 2, v[i] + acceleration * t, acceleration
    )


def draw_body(route: Route, motion: Travel, rng: np.random.Generator) -> Body:
    """Draw the body's motion: it leans out of bends, dives under braking and follows bumps along
    the road.
    """
    grid = np.arange(motion.s_m[0], motion.s_m[-1] + _GRID_M, _GRID_M)
    reach = round(3 * _BUMP_M / _GRID_M)
    kernel = np.exp(-((np.arange(-reach, reach + 1) * _GRID_M / _BUMP_M) ** 2) / 2)
    noise = rng.normal(size=(3, len(grid) + 2 * reach))
    bumps = [np.interp(motion.s_m, grid, np.convolve(row, kernel, "valid")) for row in noise]
    roll, pitch, heave = np.stack(bumps) / np.linalg.norm(kernel)
    amplitude, height = rng.uniform(*_BUMPS_RAD), rng.uniform(*_BUMPS_M)
    sideways = motion.speed_mps**2 * route.curvature(motion.s_m)
    return Body(
        roll_rad=amplitude * roll + _LEAN_RAD_PER_MPS2 * _smooth(sideways),
        pitch_rad=amplitude * pitch - _DIVE_RAD_PER_MPS2 * _smooth(motion.acceleration_mps2),
        heave_m=height * heave,
    )


def _smooth(acceleration: np.ndarray) -> np.ndarray:
    """Return the mean over the last frames [F]."""
    padded = np.pad(acceleration, (_SPRING_FRAMES - 1, 0), mode="edge")
    return np.convolve(padded, np.full(_SPRING_FRAMES, 1 / _SPRING_FRAMES), "valid")
