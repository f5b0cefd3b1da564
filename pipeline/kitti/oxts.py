"""KITTI's inertial and GNSS packets ("oxts"): what the columns mean, rows and timestamps from their text files."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from pipeline.base.errors import DamagedFile, InputError, explained

COLUMNS = (
    "lat", "lon", "alt", "roll", "pitch", "yaw", "vn", "ve", "vf", "vl", "vu", "ax", "ay", "az", "af", "al", "au",
    "wx", "wy", "wz", "wf", "wl", "wu", "pos_accuracy", "vel_accuracy", "navstat", "numsats", "posmode", "velmode",
    "orimode",
)  # fmt: skip
# Speeds forward and to the left, m/s, parallel to the earth's surface; yaw rate about the upward axis, rad/s, left +.
VF, VL, WU = (COLUMNS.index(name) for name in ("vf", "vl", "wu"))
# Heading, rad, counter-clockwise from east; forward acceleration, m/s².
YAW, AF = (COLUMNS.index(name) for name in ("yaw", "af"))
COUNTS = COLUMNS.index("navstat")  # from here on, whole numbers


def make_rows(frames: int, **columns: np.ndarray | float) -> np.ndarray:
    """Return packets, float64 [F,30], that hold these columns, each [F] or one number for all; the others are 0."""
    rows = np.zeros((frames, len(COLUMNS)))
    for name, values in columns.items():
        rows[:, COLUMNS.index(name)] = values
    return rows


def read_row(path: Path) -> np.ndarray:
    """Return one packet, float64 [30] in the order of :data:`COLUMNS`. Raises DamagedFile.

    pykitti's ``load_oxts_packets_and_poses`` reads these too, but lets NaN pass and does not say which file is short.
    """
    words = path.read_text(encoding="ascii", errors="replace").split()
    if len(words) != len(COLUMNS):
        raise DamagedFile(f"{path} has {len(words)} of {len(COLUMNS)} oxts columns")
    try:
        row = np.array(words, np.float64)
    except ValueError as error:
        raise DamagedFile(f"{path} holds something that is not a number ({error})") from error
    if not np.isfinite(row).all():
        raise DamagedFile(f"{path}: {COLUMNS[int(np.argmin(np.isfinite(row)))]} is {row[~np.isfinite(row)][0]}")
    return row


def read_times(path: Path, frames: Sequence[int]) -> np.ndarray:
    """Return the time of each of `frames` (KITTI frame numbers, ascending) in seconds since the first, float64 [F].

    Line i of a ``timestamps.txt`` belongs to frame i. A file with exactly one line per packet that is there belongs
    to a drive that was cut out of a longer one: then lines belong to `frames` by position.

    Raises InputError if the file is missing, lacks a line that is needed, or time does not increase.
    """
    if not path.is_file():
        raise InputError(f"{path} is missing: extract the drive's oxts folder with its timestamps.txt")
    lines = path.read_text(encoding="ascii", errors="replace").rstrip().split("\n")
    if len(lines) > frames[-1]:
        numbers = list(frames)
    elif len(lines) == len(frames):
        numbers = list(range(len(frames)))
    else:
        raise InputError(
            f"{path} has {len(lines)} lines, frame {frames[-1]} needs line {frames[-1] + 1}: extract it again"
        )
    with explained(f"{path} holds something that is not a time", hint="Extract it again"):
        stamps = np.array([lines[number].strip() for number in numbers], dtype="datetime64[ns]")
    if np.isnat(stamps).any():
        line = numbers[int(np.argmax(np.isnat(stamps)))] + 1
        raise InputError(f"{path} is empty at line {line}, the time of a frame that has a packet: extract it again")
    steps = np.diff(stamps)
    if (steps <= np.timedelta64(0)).any():
        at = int(np.argmax(steps <= np.timedelta64(0))) + 1
        raise InputError(
            f"{path}: time goes from {stamps[at - 1]} to {stamps[at]} at line {numbers[at] + 1}, it must increase: "
            "extract the file again, or take the drive out of ingest.drives"
        )
    # Differences are taken in whole nanoseconds: a float64 of seconds since 1970 resolves only 0.2 microseconds.
    return (stamps - stamps[0]).astype(np.int64) / 1e9
