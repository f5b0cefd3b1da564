"""KITTI's inertial and GNSS packets ("oxts"): what the columns mean, rows and timestamps from their text files."""

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from pipeline.base.errors import DamagedFile, InputError, error_context
from pipeline.base.files import MiB, read_bytes

COLUMNS = (
    "lat", "lon", "alt", "roll", "pitch", "yaw", "vn", "ve", "vf", "vl", "vu", "ax", "ay", "az", "af", "al", "au",
    "wx", "wy", "wz", "wf", "wl", "wu", "pos_accuracy", "vel_accuracy", "navstat", "numsats", "posmode", "velmode",
    "orimode",
)  # fmt: skip
# Speeds forward and to the left, m/s, parallel to the earth's surface; yaw rate about the upward axis, rad/s, left +.
VF, VL, WU = (COLUMNS.index(name) for name in ("vf", "vl", "wu"))
# Heading, rad, counter-clockwise from east; forward acceleration, m/s².
YAW, AF = (COLUMNS.index(name) for name in ("yaw", "af"))
LIMITS = {  # what no car's packet exceeds, either way: degrees, rad, m/s, rad/s (KITTI's own turn by 0.5 at most)
    "lat": 90.0, "lon": 180.0, "roll": 1.6, "pitch": 1.6, "yaw": 6.3,
    **dict.fromkeys(("vn", "ve", "vf", "vl", "vu"), 100.0), **dict.fromkeys(("wx", "wy", "wz", "wf", "wl", "wu"), 3.0),
}  # fmt: skip
_LIMITS = np.array([LIMITS.get(name, np.inf) for name in COLUMNS])
_MOST_BYTES = 64 * MiB  # of timestamps, and 1 MiB of a packet
_TIME = re.compile(r"(19|20)[0-9]{2}-[0-9]{2}-[0-9]{2} [0-9]{2}:[0-9]{2}:[0-9]{2}(\.[0-9]{1,9})?")
_LONGEST_STEP = np.timedelta64(1, "h")
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
    words = read_bytes(path, MiB).decode("ascii", errors="replace").split()
    if len(words) != len(COLUMNS):
        raise DamagedFile(f"{path} has {len(words)} of {len(COLUMNS)} oxts columns")
    try:
        row = np.array(words, np.float64)
    except ValueError as error:
        raise DamagedFile(f"{path} holds something that is not a number ({error})") from error
    if not np.isfinite(row).all():
        raise DamagedFile(f"{path}: {COLUMNS[int(np.argmin(np.isfinite(row)))]} is {row[~np.isfinite(row)][0]}")
    if (np.abs(row) > _LIMITS).any():
        column = int(np.argmax(np.abs(row) > _LIMITS))
        raise DamagedFile(f"{path}: {COLUMNS[column]} is {row[column]:g}, no car's is beyond ±{_LIMITS[column]:g}")
    return row


def read_times(path: Path, frames: Sequence[int]) -> np.ndarray:
    """Return the time of each of `frames` (KITTI frame numbers, ascending) in seconds since the first, float64 [F].

    Line i of a ``timestamps.txt`` belongs to frame i. A file with exactly one line per packet that is there belongs
    to a drive that was cut out of a longer one: then lines belong to `frames` by position.

    Raises InputError if the file is missing, lacks a line that is needed, or time does not increase.
    """
    if not path.is_file():
        raise InputError(f"{path} is missing: extract the drive's oxts folder with its timestamps.txt")
    lines = read_bytes(path, _MOST_BYTES).decode("ascii", errors="replace").rstrip().split("\n")
    if len(lines) > frames[-1]:
        numbers = list(frames)
    elif len(lines) == len(frames):
        numbers = list(range(len(frames)))
    else:
        raise InputError(
            f"{path} has {len(lines)} lines, frame {frames[-1]} needs line {frames[-1] + 1}: extract it again"
        )
    texts = [lines[number].strip() for number in numbers]
    for number, text in zip(numbers, texts, strict=True):
        if not _TIME.fullmatch(text):  # numpy would take "today", and a year alone
            fault = f"holds {text[:40]!r}, not a time," if text else "is empty"
            raise InputError(f"{path} {fault} at line {number + 1}, of a frame that has a packet: extract it again")
    with error_context(f"{path} holds something that is not a time", fix="Extract it again"):
        stamps = np.array(texts, dtype="datetime64[ns]")
    steps = np.diff(stamps)
    if (steps > _LONGEST_STEP).any():
        at = int(np.argmax(steps > _LONGEST_STEP)) + 1
        raise InputError(
            f"{path}: time goes from {stamps[at - 1]} to {stamps[at]} at line {numbers[at] + 1}, more than an hour: "
            "extract the file again, or take the drive out of ingest.drives"
        )
    if (steps <= np.timedelta64(0)).any():
        at = int(np.argmax(steps <= np.timedelta64(0))) + 1
        raise InputError(
            f"{path}: time goes from {stamps[at - 1]} to {stamps[at]} at line {numbers[at] + 1}, it must increase: "
            "extract the file again, or take the drive out of ingest.drives"
        )
    # Differences are taken in whole nanoseconds: a float64 of seconds since 1970 resolves only 0.2 microseconds.
    return (stamps - stamps[0]).astype(np.int64) / 1e9
