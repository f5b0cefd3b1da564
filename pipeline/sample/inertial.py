"""Make the oxts files that an inertial system in the simulated car would record."""

import numpy as np

from pipeline.ingest.packets import (
    EARTH_RADIUS_M,
    GRAVITY_MPS2,
    format_packet,
    format_times,
    make_packets,
)
from pipeline.sample.journey import Journey
from pipeline.sample.route import IMU_HEIGHT_M, rotation_matrix

# Altitude of the road in metres.
ALTITUDE_M = 110.0
# Delay in seconds of the recorded rates. KITTI's rates are late: in each of its 31 drives with
# bends, wu is closest to the derivative of the heading 0.055 to 0.065 s earlier. So labels belong
# to half a frame earlier, as the mean motion between two images does. Angles and speed are not
# late.
RATES_LATE_S = 0.06


def record_oxts(journey: Journey, date: str, rng: np.random.Generator) -> tuple[list[bytes], bytes]:
    """Return the oxts files and timestamps.txt of a drive at a random place and time.

    Both include the frames after the drive.
    """
    latitude_deg, longitude_deg = rng.uniform((48.9, 8.3), (49.1, 8.5))
    start_s = rng.uniform(8, 17) * 3600
    rows = oxts_rows(journey, latitude_deg, longitude_deg)
    continued = journey.extend_after()
    after = oxts_rows(continued, latitude_deg, longitude_deg)[len(rows) :]
    packets = [format_packet(row) for row in [*rows, *after]]
    return packets, format_times(continued.motion.time_s, date, start_s)


def oxts_rows(journey: Journey, latitude_deg: float, longitude_deg: float) -> np.ndarray:
    """Return oxts packets [F,30] for a level road on which the car's body moves.

    Places are converted to degrees in the tangent plane of the first frame, which agrees with
    KITTI's Mercator formula to millimetres.
    """
    route = journey.route
    motion = journey.motion
    body = journey.body
    v = motion.speed_mps
    frames = len(v)

    # The yaw rate follows from speed and curvature of the path. It is recorded late.
    late_s_m = _delay_rates(motion.s_m, motion.time_s)
    yaw_rate = _delay_rates(v, motion.time_s) * route.curvature(late_s_m)

    # The accelerometer turns with the body, so gravity appears on all of its axes when that leans.
    forward = motion.acceleration_mps2
    left = v**2 * route.curvature(motion.s_m)
    level = np.stack([forward, left, np.full(frames, GRAVITY_MPS2)], axis=-1)
    tilted = np.empty_like(level)
    for i in range(frames):
        R = rotation_matrix(body.roll_rad[i], body.pitch_rad[i], 0.0)
        tilted[i] = R.T @ level[i]
    ax, ay, az = tilted.T

    # The body's rates are the derivatives of its motion. Roll and pitch rates are recorded late.
    rates = np.zeros((3, 1))
    if frames > 1:
        rates = np.gradient(body, motion.time_s, axis=1)
    roll_rate, pitch_rate, heave_rate = rates
    roll_rate = _delay_rates(roll_rate, motion.time_s)
    pitch_rate = _delay_rates(pitch_rate, motion.time_s)

    xy, heading_rad = route.place_at(motion.s_m)
    east_m, north_m = (xy - xy[0]).T
    parallel_radius_m = EARTH_RADIUS_M * np.cos(np.deg2rad(latitude_deg))
    return make_packets(
        frames,
        lat=latitude_deg + np.rad2deg(north_m / EARTH_RADIUS_M),
        lon=longitude_deg + np.rad2deg(east_m / parallel_radius_m),
        yaw=np.arctan2(np.sin(heading_rad), np.cos(heading_rad)),
        vn=v * np.sin(heading_rad),
        ve=v * np.cos(heading_rad),
        vf=v,
        af=forward,
        al=left,
        au=GRAVITY_MPS2,
        wz=yaw_rate,
        wu=yaw_rate,
        alt=ALTITUDE_M + IMU_HEIGHT_M + body.heave_m,
        roll=body.roll_rad,
        pitch=body.pitch_rad,
        vu=heave_rate,
        ax=ax,
        ay=ay,
        az=az,
        # The body leans by less than a degree, so rates about its own axes equal those about the
        # axes of the road.
        wx=roll_rate,
        wy=pitch_rate,
        wf=roll_rate,
        wl=pitch_rate,
        pos_accuracy=0.05,
        vel_accuracy=0.02,
        navstat=4,
        numsats=9,
        posmode=4,
        velmode=4,
        orimode=4,
    )


def _delay_rates(values: np.ndarray, time_s: np.ndarray) -> np.ndarray:
    """Return the values [F] that held :data:`RATES_LATE_S` before each frame."""
    return np.interp(time_s - RATES_LATE_S, time_s, values)
