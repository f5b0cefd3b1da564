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
    """Return the rows of KITTI's oxts files, [F,30], for a level road, on which the car's body moves."""
    xy, heading = route.at(motion.s_m)
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
        **level_columns(xy, heading, v, a, sideways, yaw_rate, latitude_deg, longitude_deg),
        alt=ALTITUDE_M + IMU_HEIGHT_M + body.heave_m,
        roll=roll, pitch=pitch, vu=climb,
        ax=ax, ay=ay, az=az,
        # Of angles below a degree: the body's rates about its own axes and about the road's are the same.
        wx=roll_rate, wy=pitch_rate, wf=roll_rate, wl=pitch_rate,
        pos_accuracy=0.05, vel_accuracy=0.02, navstat=4, numsats=9, posmode=4, velmode=4, orimode=4,
    )  # fmt: skip


def level_columns(
    xy_m: np.ndarray, heading_rad: np.ndarray, speed_mps: np.ndarray, forward_mps2: np.ndarray, left_mps2: np.ndarray,
    yaw_rate_radps: np.ndarray, latitude_deg: float, longitude_deg: float,
) -> dict[str, np.ndarray | float]:  # fmt: skip
    """Return the columns of oxts that say how a car moves in the plane; it does not slide sideways.

    Latitude and longitude by the local tangent plane at the first row's latitude, which agrees with KITTI's Mercator
    formula to millimetres over a drive.

    Args:
        xy_m: to the east and to the north, [F,2].
        heading_rad: counter-clockwise from east, [F].
        speed_mps, forward_mps2, left_mps2, yaw_rate_radps: speed forward, accelerations, yaw rate left +, all [F].
        latitude_deg, longitude_deg: of the first row.
    """
    east_m, north_m = (xy_m - xy_m[0]).T
    return {
        "lat": latitude_deg + np.rad2deg(north_m / EARTH_RADIUS_M),
        "lon": longitude_deg + np.rad2deg(east_m / (EARTH_RADIUS_M * np.cos(np.deg2rad(latitude_deg)))),
        "yaw": np.arctan2(np.sin(heading_rad), np.cos(heading_rad)),
        "vn": speed_mps * np.sin(heading_rad),
        "ve": speed_mps * np.cos(heading_rad),
        "vf": speed_mps,
        "af": forward_mps2,
        "al": left_mps2,
        "au": GRAVITY_MPS2,
        "wz": yaw_rate_radps,
        "wu": yaw_rate_radps,
    }


def _rate(values: np.ndarray, time_s: np.ndarray) -> np.ndarray:
    """Return the derivative [F] of values [F] by time; of a single frame, 0."""
    return np.gradient(values, time_s) if len(values) > 1 else np.zeros(1)


def _late(values: np.ndarray, time_s: np.ndarray) -> np.ndarray:
    """Return values [F] as they were :data:`RATES_LATE_S` before; the first, as it is."""
    return np.interp(time_s - RATES_LATE_S, time_s, values)
