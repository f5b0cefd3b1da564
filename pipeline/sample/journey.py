"""Draw the pose of the ego in every frame: its way along the route, and its body on springs."""

from typing import NamedTuple

import numpy as np

from pipeline.camera.geometry import rigid
from pipeline.sample.plan import Character
from pipeline.sample.route import AHEAD_M, IMU_HEIGHT_M, STEP_M, Route, draw_route, rotation_matrix

# Time between two frames in seconds, as in KITTI's synchronised stream.
PERIOD_S = 0.1036
# Largest deviation of a frame's time from a constant frame rate, in seconds.
JITTER_S = 0.001
# Number of frames that oxts records after the last image. In most drives they cover 30 m, the path
# ahead of the last images.
FRAMES_AFTER = 45
# Acceleration of the ego after bends and stops, in m/s².
ACCELERATE_MPS2 = 1.8
# Deceleration of the ego before bends and stops, in m/s².
BRAKE_MPS2 = 2.2
# Range over drivers of the largest lateral acceleration in bends, in m/s².
LATERAL_MPS2 = (1.5, 3.2)
# Distance in metres between a stop and the centre of the junction after it.
_STOP_BEFORE_M = 13.0
# Range of a stop's duration in seconds.
_WAIT_S = (0.8, 2.0)

# Roll of the body in rad for each m/s² of lateral acceleration.
_LEAN_RAD_PER_MPS2 = 0.004
# Pitch of the body in rad for each m/s² of deceleration.
_DIVE_RAD_PER_MPS2 = 0.003
# Range over drives of the standard deviation of roll and pitch on bumps, in rad.
_BUMPS_RAD = np.deg2rad((0.03, 0.2))
# Range over drives of the standard deviation of the height on bumps, in metres.
_BUMPS_M = (0.002, 0.012)
# Half the length of a bump along the road in metres.
_BUMP_M = 2.0
# Number of frames within which the body responds to a step of the acceleration.
_SPRING_FRAMES = 5
# Distance in metres between the samples of bumps.
_GRID_M = 0.25


class Travel(NamedTuple):
    """The ego's progress along the route, per frame [F]."""

    time_s: np.ndarray
    s_m: np.ndarray
    speed_mps: np.ndarray
    acceleration_mps2: np.ndarray


class Body(NamedTuple):
    """The body's motion on its springs, per frame [F]; signs are those of oxts."""

    roll_rad: np.ndarray  # positive if the left side is up
    pitch_rad: np.ndarray  # positive if the front is down
    heave_m: np.ndarray  # height of the body above its mean


class Journey(NamedTuple):
    """The motion of the IMU and of the body in the F frames of a drive."""

    route: Route
    motion: Travel
    after: Travel  # the motion in the FRAMES_AFTER frames after the drive
    body: Body

    def extend_after(self) -> "Journey":
        """Return the journey with the frames `after`, in which the body keeps its last lean."""
        columns = [np.concatenate(pair) for pair in zip(self.motion, self.after, strict=True)]
        leans = [np.pad(lean, (0, FRAMES_AFTER), mode="edge") for lean in self.body]
        return Journey(self.route, Travel(*columns), self.after, Body(*leans))

    def pose_at(self, frame: int) -> np.ndarray:
        """Return the pose T_world_imu [4,4] in a frame."""
        (x, y), heading_rad = self.route.place_at(self.motion.s_m[frame])
        body = self.body
        R = rotation_matrix(body.roll_rad[frame], body.pitch_rad[frame], float(heading_rad))
        return rigid(R, [x, y, IMU_HEIGHT_M + body.heave_m[frame]])


def draw_journey(
    rng: np.random.Generator, frames: int, character: Character, first: str
) -> Journey:
    """Draw a road that begins with the manoeuvre `first`, and a drive of `frames` frames on it."""
    time_s = frame_times(rng, frames)
    cruise_mps = rng.uniform(*character.quarter.cruise_mps)
    route = draw_route(rng, cruise_mps * time_s[-1] + AHEAD_M, character.lane_m, first)

    # The driver slows down in bends, and in some drives stops.
    lateral_mps2 = rng.uniform(*LATERAL_MPS2)
    stop_m = draw_stop(rng, route, 0.75 * cruise_mps * time_s[-1])
    speed_mps = speed_profile(route, cruise_mps, lateral_mps2, stop_m)
    wait_s = rng.uniform(*_WAIT_S)

    after_s = time_s[-1] + PERIOD_S * np.arange(1, FRAMES_AFTER + 1)
    motion = drive_route(route, speed_mps, time_s, wait_s)
    after = drive_route(route, speed_mps, after_s, wait_s)
    return Journey(route, motion, after, draw_body(route, motion, rng))


def frame_times(rng: np.random.Generator, frames: int) -> np.ndarray:
    """Draw frame times [F] in seconds since the first frame, ascending, with jitter."""
    time_s = np.arange(frames) * PERIOD_S + rng.uniform(-JITTER_S, JITTER_S, frames)
    return time_s - time_s[0]


def speed_profile(
    route: Route, cruise_mps: float, lateral_mps2: float, stop_m: float | None
) -> np.ndarray:
    """Return the speed at the route's samples [N].

    It is limited by `lateral_mps2` in bends, and zero at `stop_m` along the route.
    """
    curvature_1pm = np.maximum(np.abs(route.curvature_1pm), 1e-6)
    speed_mps = np.minimum(cruise_mps, np.sqrt(lateral_mps2 / curvature_1pm))
    if stop_m is not None:
        speed_mps[round((stop_m - route.s_m[0]) / STEP_M)] = 0.0

    # The speed is also limited by the acceleration after slower places, and by the braking before.
    for i in range(1, len(speed_mps)):
        reachable_mps = np.sqrt(speed_mps[i - 1] ** 2 + 2 * ACCELERATE_MPS2 * STEP_M)
        speed_mps[i] = min(speed_mps[i], reachable_mps)
    for i in range(len(speed_mps) - 2, -1, -1):
        reachable_mps = np.sqrt(speed_mps[i + 1] ** 2 + 2 * BRAKE_MPS2 * STEP_M)
        speed_mps[i] = min(speed_mps[i], reachable_mps)
    return speed_mps


def draw_stop(rng: np.random.Generator, route: Route, before_m: float) -> float | None:
    """Draw where the ego stops, ahead of a junction before `before_m`; None if it does not."""
    places_m = []
    for junction_m in route.junctions_m:
        place_m = junction_m - _STOP_BEFORE_M
        if 15 < place_m < before_m:
            places_m.append(place_m)
    if places_m and rng.random() < 0.2:
        return places_m[rng.integers(len(places_m))]
    return None


def drive_route(route: Route, speed_mps: np.ndarray, times_s: np.ndarray, wait_s: float) -> Travel:
    """Drive along the route from s = 0 with the speeds [N] of its samples.

    Where the speed is 0, the ego waits for `wait_s`. Acceleration is constant between samples of
    the route, so that positions integrate speeds exactly.
    """
    start = round(-route.s_m[0] / STEP_M)
    s_m = route.s_m[start:]
    v_mps = speed_mps[start:]

    # Knots are the samples of the route with their times. A stop has two: arrival and departure.
    stop = np.flatnonzero(v_mps == 0)
    s_m = np.insert(s_m, stop, s_m[stop])
    v_mps = np.insert(v_mps, stop, 0.0)
    twice_mean_mps = v_mps[1:] + v_mps[:-1]
    moving = twice_mean_mps > 0
    duration_s = np.full(len(moving), wait_s)
    duration_s[moving] = 2 * np.diff(s_m)[moving] / twice_mean_mps[moving]
    knots_s = np.concatenate([[0.0], np.cumsum(duration_s)])

    # From the knot before each time, the ego moves with constant acceleration.
    knot = np.searchsorted(knots_s, times_s, side="right") - 1
    acceleration = np.diff(v_mps)[knot] / duration_s[knot]
    t = times_s - knots_s[knot]
    s_m = s_m[knot] + v_mps[knot] * t + acceleration * t**2 / 2
    return Travel(times_s, s_m, v_mps[knot] + acceleration * t, acceleration)


def draw_body(route: Route, motion: Travel, rng: np.random.Generator) -> Body:
    """Draw the motion of the body: it leans out of bends, dives when braking, follows bumps."""
    # Bumps are smooth noise along the road, with a standard deviation of 1.
    grid_m = np.arange(motion.s_m[0], motion.s_m[-1] + _GRID_M, _GRID_M)
    reach = round(3 * _BUMP_M / _GRID_M)
    kernel = np.exp(-((np.arange(-reach, reach + 1) * _GRID_M / _BUMP_M) ** 2) / 2)
    noise = rng.normal(size=(3, len(grid_m) + 2 * reach))
    smooth = [np.convolve(row, kernel, "valid") for row in noise]
    bumps = [np.interp(motion.s_m, grid_m, row) for row in smooth]
    roll, pitch, heave = np.stack(bumps) / np.linalg.norm(kernel)

    # The springs add the response to the acceleration.
    bumps_rad = rng.uniform(*_BUMPS_RAD)
    bumps_m = rng.uniform(*_BUMPS_M)
    sideways_mps2 = motion.speed_mps**2 * route.curvature(motion.s_m)
    return Body(
        roll_rad=bumps_rad * roll + _LEAN_RAD_PER_MPS2 * _smooth_springs(sideways_mps2),
        pitch_rad=bumps_rad * pitch
        - _DIVE_RAD_PER_MPS2 * _smooth_springs(motion.acceleration_mps2),
        heave_m=bumps_m * heave,
    )


def _smooth_springs(acceleration: np.ndarray) -> np.ndarray:
    """Return for each frame the mean over the last _SPRING_FRAMES frames, [F]."""
    padded = np.pad(acceleration, (_SPRING_FRAMES - 1, 0), mode="edge")
    return np.convolve(padded, np.full(_SPRING_FRAMES, 1 / _SPRING_FRAMES), "valid")
