"""The oxts rows that an inertial system in the car would record."""

import numpy as np

from pipeline.kitti.oxts import make_rows
from pipeline.town.body import Body
from pipeline.town.motion import IMU_HEIGHT_M, Motion
from pipeline.town.rig import rotation
from pipeline.town.route import Route

ALTITUDE_M = 110.0  # of the road
GRAVITY_MPS2 = 9.81
EARTH_RADIUS_M = 6378137.0
# KITTI's rates are late: in each of its 31 drives that bend, wu fits the heading's derivative of 0.055 to 0.065 s ago
# best. So its labels are those of half a frame ago, as is the mean motion between two images; angles and speed are not.
RATES_LATE_S = 0.06


def oxts_rows(route: Route, motion: Motion, body: Body, latitude_deg: float, longitude_deg: float) -> np.ndarray:
    """Return the rows of KITTI's oxts files, [F,30], for a level road, on which the car's body moves.

    Latitude and longitude by the local tangent plane at the first row's latitude, which agrees with KITTI's Mercator
    formula to millimetres over a drive.
    """
    xy, heading = route.at(motion.s_m)
    xy = xy - xy[0]
    v, a, roll, pitch = motion.speed_mps, motion.acceleration_mps2, body.roll_rad, body.pitch_rad
    sideways = v**2 * route.curvature(motion.s_m)
    yaw_rate = _late(v, motion.time_s) * route.curvature(_late(motion.s_m, motion.time_s))
    # The accelerometer's axes are the body's: gravity shows on all three when it leans.
    level = np.stack([a, sideways, np.full(len(v), GRAVITY_MPS2)], axis=-1)
    tilts = [rotation(x, y, 0.0) for x, y in zip(roll, pitch, strict=True)]
    ax, ay, az = np.stack([R.T @ row for R, row in zip(tilts, level, strict=True)]).T
    roll_rate, pitch_rate, climb = (_rate(values, motion.time_s) for values in (roll, pitch, body.heave_m))
    roll_rate, pitch_rate = (_late(rate, motion.time_s) for rate in (roll_rate, pitch_rate))
    return make_rows(
        len(v),
        lat=latitude_deg + np.rad2deg(xy[:, 1] / EARTH_RADIUS_M),
        lon=longitude_deg + np.rad2deg(xy[:, 0] / (EARTH_RADIUS_M * np.cos(np.deg2rad(latitude_deg)))),
        alt=ALTITUDE_M + IMU_HEIGHT_M + body.heave_m,
        roll=roll, pitch=pitch, yaw=np.arctan2(np.sin(heading), np.cos(heading)),
        vn=v * np.sin(heading), ve=v * np.cos(heading), vf=v, vu=climb,
        ax=ax, ay=ay, az=az, af=a, al=sideways, au=GRAVITY_MPS2,
        # Of angles below a degree: the body's rates about its own axes and about the road's are the same.
        wx=roll_rate, wy=pitch_rate, wz=yaw_rate, wf=roll_rate, wl=pitch_rate, wu=yaw_rate,
        pos_accuracy=0.05, vel_accuracy=0.02, navstat=4, numsats=9, posmode=4, velmode=4, orimode=4,
    )  # fmt: skip


def _rate(values: np.ndarray, time_s: np.ndarray) -> np.ndarray:
    """Return the derivative [F] of values [F] by time; of a single frame, 0."""
    return np.gradient(values, time_s) if len(values) > 1 else np.zeros(1)


def _late(values: np.ndarray, time_s: np.ndarray) -> np.ndarray:
    """Return values [F] as they were :data:`RATES_LATE_S` before; the first, as it is."""
    return np.interp(time_s - RATES_LATE_S, time_s, values)
