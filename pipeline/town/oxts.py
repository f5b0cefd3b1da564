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


def oxts_rows(route: Route, motion: Motion, body: Body, latitude_deg: float, longitude_deg: float) -> np.ndarray:
    """Return the rows of KITTI's oxts files, [F,30], for a level road, on which the car's body moves.

    Latitude and longitude by the local tangent plane at the first row's latitude, which agrees with KITTI's Mercator
    formula to millimetres over a drive.
    """
    xy, heading = route.at(motion.s_m)
    xy = xy - xy[0]
    v, a, roll, pitch = motion.speed_mps, motion.acceleration_mps2, body.roll_rad, body.pitch_rad
    yaw_rate = v * route.curvature(motion.s_m)
    sideways = v * yaw_rate
    # The accelerometer's axes are the body's: gravity shows on all three when it leans.
    level = np.stack([a, sideways, np.full(len(v), GRAVITY_MPS2)], axis=-1)
    tilts = [rotation(x, y, 0.0) for x, y in zip(roll, pitch, strict=True)]
    ax, ay, az = np.stack([R.T @ row for R, row in zip(tilts, level, strict=True)]).T
    roll_rate, pitch_rate, climb = (_rate(values, motion.time_s) for values in (roll, pitch, body.heave_m))
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
