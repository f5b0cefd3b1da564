"""Oxts files of a drive: as recorded, or as an inertial system in the simulated car would record them."""

from dataclasses import dataclass

import numpy as np

from pipeline.base.errors import InputError
from pipeline.kitti.oxts import (
    GRAVITY_MPS2,
    format_packet,
    format_times,
    level_columns,
    make_rows,
    read_row,
    read_times,
)
from pipeline.kitti.raw import RawDrive
from pipeline.sample.motion import Journey
from pipeline.sample.rig import rotation
from pipeline.sample.route import IMU_HEIGHT_M

ALTITUDE_M = 110.0  # of the road
# KITTI's rates are late: in each of its 31 drives with bends, wu fits the heading's derivative of 0.055 to 0.065 s
# earlier best. So labels belong to half a frame earlier, as does the mean motion between two images; angles and speed
# do not.
RATES_LATE_S = 0.06


@dataclass(frozen=True)
class Recording:
    """Packets rows [F,30] as :data:`pipeline.kitti.oxts.COLUMNS`, time_s [F] since the first, and file contents."""

    rows: np.ndarray
    time_s: np.ndarray
    packets: dict[int, bytes]  # frame number -> its oxts file
    timestamps: bytes


def read_recording(raw: RawDrive, most: int) -> Recording:
    """Return the oxts of the first `most` frames of a real drive, unchanged.

    Raises InputError if there are none, DamagedFile if a packet cannot be read.
    """
    frames = list(raw.oxts)[:most]
    if not frames:
        raise InputError("drive has no packets, which sample.replay needs", raw.folder / "oxts" / "data", "Extract it")
    rows = np.array([read_row(raw.oxts[frame]) for frame in frames])
    time_s = read_times(raw.oxts_times, list(raw.oxts))[: len(frames)]
    timestamps = raw.oxts_times.read_bytes()
    if len(frames) < len(raw.oxts) and len(timestamps.rstrip().split(b"\n")) <= max(raw.oxts):
        raise InputError(
            f"file has one line per packet, so the lines of the first {most} packets alone are ambiguous",
            raw.oxts_times,
            f"Raise sample.frames to {len(raw.oxts)}",
        )
    packets = {frame: raw.oxts[frame].read_bytes() for frame in frames}
    return Recording(rows, time_s, packets, timestamps)


def make_recording(rows: np.ndarray, time_s: np.ndarray, date: str, start_s: float) -> Recording:
    """Return the files for packets `rows` [F,30] at `time_s` [F]; the first is `start_s` after midnight of `date`."""
    packets = {frame: format_packet(row) for frame, row in enumerate(rows)}
    return Recording(rows, time_s, packets, format_times(time_s, date, start_s))


def record(journey: Journey, date: str, rng: np.random.Generator) -> Recording:
    """Return the oxts files of a drawn drive and of the frames after it, at a random place and time of day."""
    place_deg, complete = rng.uniform((48.9, 8.3), (49.1, 8.5)), journey.continued()
    rows = oxts_rows(journey, *place_deg)
    rows = np.concatenate([rows, oxts_rows(complete, *place_deg)[len(rows) :]])
    return make_recording(rows, complete.motion.time_s, date, start_s=rng.uniform(8, 17) * 3600)


def oxts_rows(journey: Journey, latitude_deg: float, longitude_deg: float) -> np.ndarray:
    """Return oxts packets [F,30] for a level road on which the car's body moves."""
    route, motion, body = journey.route, journey.motion, journey.body
    v, a, roll, pitch = motion.speed_mps, motion.acceleration_mps2, body.roll_rad, body.pitch_rad
    sideways = v**2 * route.curvature(motion.s_m)
    yaw_rate = _late(v, motion.time_s) * route.curvature(_late(motion.s_m, motion.time_s))
    # The accelerometer's axes are the body's: gravity appears on all three when it leans.
    level = np.stack([a, sideways, np.full(len(v), GRAVITY_MPS2)], axis=-1)
    tilts = [rotation(x, y, 0.0) for x, y in zip(roll, pitch, strict=True)]
    ax, ay, az = np.stack([R.T @ row for R, row in zip(tilts, level, strict=True)]).T
    roll_rate, pitch_rate, climb = (_rate(values, motion.time_s) for values in (roll, pitch, body.heave_m))
    roll_rate, pitch_rate = (_late(rate, motion.time_s) for rate in (roll_rate, pitch_rate))
    return make_rows(
        len(v),
        **level_columns(journey.xy, journey.heading_rad, v, a, sideways, yaw_rate, latitude_deg, longitude_deg),
        alt=ALTITUDE_M + IMU_HEIGHT_M + body.heave_m,
        roll=roll, pitch=pitch, vu=climb,
        ax=ax, ay=ay, az=az,
        # Below a degree, the body's rates about its own axes and about the road's are equal.
        wx=roll_rate, wy=pitch_rate, wf=roll_rate, wl=pitch_rate,
        pos_accuracy=0.05, vel_accuracy=0.02, navstat=4, numsats=9, posmode=4, velmode=4, orimode=4,
    )  # fmt: skip


def _rate(values: np.ndarray, time_s: np.ndarray) -> np.ndarray:
    """Return the time derivative [F] of values [F]; 0 for a single frame."""
    return np.gradient(values, time_s) if len(values) > 1 else np.zeros(1)


def _late(values: np.ndarray, time_s: np.ndarray) -> np.ndarray:
    """Return values [F] as of :data:`RATES_LATE_S` earlier."""
    return np.interp(time_s - RATES_LATE_S, time_s, values)
