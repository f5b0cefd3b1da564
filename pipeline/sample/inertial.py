"""Make the oxts files that an inertial system in the simulated car would record."""

import numpy as np

from pipeline.ingest.packets import EARTH_RADIUS_M, format_packet, format_times, make_packets
from pipeline.sample.journey import Journey
from pipeline.sample.route import IMU_HEIGHT_M

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
    journey = journey.extend_after()
    packets = [format_packet(row) for row in oxts_rows(journey, latitude_deg, longitude_deg)]
    return packets, format_times(journey.motion.time_s, date, start_s)


def oxts_rows(journey: Journey, latitude_deg: float, longitude_deg: float) -> np.ndarray:
    """Return oxts packets [F,30] for a level road on which the car's body moves.

    They have the place, the angles, the forward speed and the yaw rate. Other columns are 0, and
    no mode says that a packet is interpolated. Places are converted to degrees in the tangent plane
    of the first frame, which agrees with KITTI's Mercator formula to millimetres.
    """
    route = journey.route
    motion = journey.motion
    body = journey.body

    # The yaw rate follows from speed and curvature of the path. It is recorded late.
    late_s_m = _delay_rates(motion.s_m, motion.time_s)
    late_mps = _delay_rates(motion.speed_mps, motion.time_s)

    xy, heading_rad = route.place_at(motion.s_m)
    east_m, north_m = (xy - xy[0]).T
    parallel_radius_m = EARTH_RADIUS_M * np.cos(np.deg2rad(latitude_deg))
    return make_packets(
        len(motion.s_m),
        lat=latitude_deg + np.rad2deg(north_m / EARTH_RADIUS_M),
        lon=longitude_deg + np.rad2deg(east_m / parallel_radius_m),
        alt=ALTITUDE_M + IMU_HEIGHT_M + body.heave_m,
        roll=body.roll_rad,
        pitch=body.pitch_rad,
        yaw=np.arctan2(np.sin(heading_rad), np.cos(heading_rad)),
        vf=motion.speed_mps,
        wu=late_mps * route.curvature(late_s_m),
        posmode=4,
        velmode=4,
        orimode=4,
    )


def _delay_rates(values: np.ndarray, time_s: np.ndarray) -> np.ndarray:
    """Return the values [F] that held :data:`RATES_LATE_S` before each frame."""
    return np.interp(time_s - RATES_LATE_S, time_s, values)
