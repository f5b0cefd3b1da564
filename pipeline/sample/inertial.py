"""Oxts files as an inertial system in the simulated car would record them."""

import numpy as np

from pipeline.ingest.packets import (
    EARTH_RADIUS_M,
    GRAVITY_MPS2,
    format_packet,
    format_times,
    make_rows,
)
from pipeline.sample.journey import Journey
from pipeline.sample.route import IMU_HEIGHT_M, rotation

ALTITUDE_M = 110.0  # of the road
# KITTI's rates are late: in each of its 31 drives with bends, wu fits the heading's derivative of
# 0.055 to 0.065 s earlier best. So labels belong to half a frame earlier, as does the mean motion
# between two images; angles and speed do not.
RATES_LATE_S = 0.06


def record(journey: Journey, date: str, rng: np.random.Generator) -> tuple[list[bytes], bytes]:
    """Return the oxts files of a drive and of the frames after it, and timestamps.txt, at a random
    place and time.
    """
    place_deg, complete = rng.uniform((48.9, 8.3), (49.1, 8.5)), journey.continued()
    rows = oxts_rows(journey, *place_deg)
    rows = np.concatenate([rows, oxts_rows(complete, *place_deg)[len(rows) :]])
    times = format_times(complete.motion.time_s, date, start_s=rng.uniform(8, 17) * 3600)
    return [format_packet(row) for row in rows], times


def oxts_rows(journey: Journey, latitude_deg: float, longitude_deg: float) -> np.ndarray:
    """Return oxts packets [F,30] for a level road on which the car's body moves.

    Places follow from the first frame's tangent plane, which agrees with KITTI's Mercator formula
    to millimetres.
    """
    route, motion, body = journey.route, journey.motion, journey.body
    v, a, roll, pitch = motion.speed_mps, motion.acceleration_mps2, body.roll_rad, body.pitch_rad
    sideways = v**2 * route.curvature(motion.s_m)
    yaw_rate = _late(v, motion.time_s) * route.curvature(_late(motion.s_m, motion.time_s))
    # The accelerometer's axes are the body's: gravity appears on all three when it leans.
    level = np.stack([a, sideways, np.full(len(v), GRAVITY_MPS2)], axis=-1)
    tilts = [rotation(x, y, 0.0) for x, y in zip(roll, pitch, strict=True)]
    ax, ay, az = np.stack([R.T @ row for R, row in zip(tilts, level, strict=True)]).T
    # of roll, pitch, heave
    rates = np.gradient([*body], motion.time_s, axis=1) if len(v) > 1 else np.zeros((3, 1))
    roll_rate, pitch_rate = (_late(rate, motion.time_s) for rate in rates[:2])
    xy, heading_rad = route.at(motion.s_m)
    east_m, north_m = (xy - xy[0]).T
    return make_rows(
        len(v),
        lat=latitude_deg + np.rad2deg(north_m / EARTH_RADIUS_M),
        lon=longitude_deg
        + np.rad2deg(east_m / (EARTH_RADIUS_M * np.cos(np.deg2rad(latitude_deg)))),
        yaw=np.arctan2(np.sin(heading_rad), np.cos(heading_rad)),
        vn=v * np.sin(heading_rad),
        ve=v * np.cos(heading_rad),
        vf=v,
        af=a,
        al=sideways,
        au=GRAVITY_MPS2,
        wz=yaw_rate,
        wu=yaw_rate,
        alt=ALTITUDE_M + IMU_HEIGHT_M + body.heave_m,
        roll=roll,
        pitch=pitch,
        vu=rates[2],
        ax=ax,
        ay=ay,
        az=az,
        # Below a degree, the body's rates about its own axes and about the road's are equal.
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


def _late(values: np.ndarray, time_s: np.ndarray) -> np.ndarray:
    """Return values [F] as of :data:`RATES_LATE_S` earlier."""
    return np.interp(time_s - RATES_LATE_S, time_s, values)
