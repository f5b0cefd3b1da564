"""Recorded motion of a drive: KITTI's inertial and GNSS packets ("oxts"), timestamps, and steering
angles.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from pipeline.base.errors import DamagedFile, InputError
from pipeline.ingest.columns import (
    LIMIT_MPS,
    LIMIT_RAD,
    LIMIT_RADPS,
    check_increase,
    fault,
    read_columns,
    refuse,
)

COLUMNS = (
    "lat",
    "lon",
    "alt",
    "roll",
    "pitch",
    "yaw",
    "vn",
    "ve",
    "vf",
    "vl",
    "vu",
    "ax",
    "ay",
    "az",
    "af",
    "al",
    "au",
    "wx",
    "wy",
    "wz",
    "wf",
    "wl",
    "wu",
    "pos_accuracy",
    "vel_accuracy",
    "navstat",
    "numsats",
    "posmode",
    "velmode",
    "orimode",
)
# Speeds forward and to the left, m/s, parallel to the earth's surface; yaw rate about the upward
# axis, rad/s, left +.
MOTION = {
    "speed_mps": COLUMNS.index("vf"),
    "left_mps": COLUMNS.index("vl"),
    "yaw_rate_radps": COLUMNS.index("wu"),
}
_COUNTS = COLUMNS.index("navstat")  # integers from here on
_LIMITS = np.array(
    [{"vf": LIMIT_MPS, "vl": LIMIT_MPS, "wu": LIMIT_RADPS}.get(name, np.inf) for name in COLUMNS]
)
GRAVITY_MPS2 = 9.81
EARTH_RADIUS_M = 6378137.0
STEERING = "steering.csv"  # in a drive's folder: recorded angles, which KITTI itself lacks


def make_rows(frames: int, **columns: np.ndarray | float) -> np.ndarray:
    """Return packets, float64 [F,30], from named columns [F] or constants; other columns are 0."""
    rows = np.zeros((frames, len(COLUMNS)))
    for name, values in columns.items():
        rows[:, COLUMNS.index(name)] = values
    return rows


def interpolated(rows: np.ndarray) -> np.ndarray:
    """Return which packets [F,30] KITTI interpolated, bool [F]: a mode of position, velocity or
    orientation is -1.

    Labels from interpolated packets of 2011_10_03_drive_0027 are off by 0.04 rad rms, others by
    0.006.
    """
    return np.asarray((rows[:, COLUMNS.index("posmode") :] == -1).any(axis=1))


def recorded_motion(packets: Mapping[int, np.ndarray]) -> dict[str, dict[int, float]]:
    """Return name → frame number → value of packets [30]: speeds forward and to the left, and the
    yaw rate.

    In m/s and rad/s, left positive; NaN in an interpolated packet, which is no measurement.
    """
    measured = {number: row for number, row in packets.items() if not interpolated(row[None])[0]}
    return {
        name: {
            number: float(measured[number][column]) if number in measured else np.nan
            for number in packets
        }
        for name, column in MOTION.items()
    }


def format_packet(row: np.ndarray) -> bytes:
    """Return the content of a packet's file for a row [30]."""
    words = [f"{value:.13g}" for value in row[:_COUNTS]] + [
        f"{value:.0f}" for value in row[_COUNTS:]
    ]
    return (" ".join(words) + "\n").encode("ascii")


def format_times(time_s: np.ndarray, date: str, start_s: float) -> bytes:
    """Return ``timestamps.txt`` for times [F] in seconds; 0 is `start_s` after midnight of `date`,
    e.g. 2026_01_01.
    """
    stamps = np.datetime64(date.replace("_", "-"), "ns") + np.rint((start_s + time_s) * 1e9).astype(
        "timedelta64[ns]"
    )
    return "".join(f"{stamp}\n".replace("T", " ") for stamp in stamps).encode("ascii")


def read_row(path: Path) -> np.ndarray:
    """Return one packet, float64 [30] in the order of :data:`COLUMNS`. Raises DamagedFile."""
    words = path.read_text("ascii", errors="replace").split()
    if len(words) != len(COLUMNS):
        raise DamagedFile(f"expected {len(COLUMNS)} oxts columns, got {len(words)}", path)
    try:
        row = np.array(words, np.float64)
    except ValueError as error:
        raise DamagedFile(f"expected numbers ({error})", path) from error
    beyond = ~(np.isfinite(row) & (np.abs(row) <= _LIMITS))
    if beyond.any():
        column = int(np.argmax(beyond))
        raise DamagedFile(
            f"implausible {COLUMNS[column]} = {row[column]:g} (limit ±{_LIMITS[column]:g})", path
        )
    return row


def read_times(path: Path, frames: Sequence[int]) -> np.ndarray:
    """Return the time of each of `frames` (KITTI frame numbers, ascending) in seconds since the
    first, float64 [F].

    Line i of ``timestamps.txt`` belongs to frame i. A file with exactly one line per existing file
    belongs to a drive cut out of a longer one: then lines belong to `frames` by position. Raises
    InputError if the file or a line is missing, or time does not increase.
    """
    if not path.is_file():
        raise InputError(
            "file is missing", path, f"Extract the drive's {path.parent.name} folder again"
        )
    lines = path.read_text("ascii", errors="replace").rstrip().split("\n")
    numbers = list(frames) if len(lines) > frames[-1] else list(range(len(frames)))
    if len(lines) <= frames[-1] and len(lines) != len(frames):
        raise InputError(
            f"expected at least {frames[-1] + 1} lines for frame {frames[-1]}, got {len(lines)}",
            path,
        )
    words = pd.Series(lines, np.arange(len(lines)) + 1, name="time").iloc[numbers]
    stamps = pd.to_datetime(words, format="ISO8601", errors="coerce").astype("datetime64[ns]")
    refuse(fault(words[stamps.isna()], "is not a date and time"), path, "Correct it")
    # Differences in nanoseconds: a float64 of seconds since 1970 resolves only 0.2 microseconds.
    time_s = (stamps - stamps.iloc[0]).astype("int64") / 1e9
    refuse(check_increase(time_s, 1e-9), path, "Correct or remove it")
    return time_s.to_numpy()


def read_steering(path: Path) -> dict[int, float]:
    """Return frame number → angle of the front wheels in rad, left positive. Raises InputError."""
    expected = (
        "Expected CSV: frame (number of the image), steering_rad (angle of the front wheels, left "
        "+)"
    )
    table, faults = read_columns(path, {"frame": np.inf, "steering_rad": LIMIT_RAD}, expected)
    refuse(faults + check_increase(table["frame"], 1), path, expected)
    return table.dropna().astype({"frame": int}).set_index("frame")["steering_rad"].to_dict()
