"""Read and write a drive's recorded motion: KITTI's packets ("oxts"), times, steering angles."""

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
    list_fault,
    read_columns,
    refuse_faults,
)

# Columns of a packet by the inertial and GNSS system, in order.
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
# Places of the motion in a packet: speeds forward and to the left, parallel to the earth's surface,
# and the yaw rate about the upward axis, left positive.
MOTION = {
    "speed_mps": COLUMNS.index("vf"),
    "left_mps": COLUMNS.index("vl"),
    "yaw_rate_radps": COLUMNS.index("wu"),
}
# Place of the first integer in a packet; all further columns are integers, too.
_COUNTS = COLUMNS.index("navstat")
# Largest plausible magnitudes of the columns.
_LIMITS = np.full(len(COLUMNS), np.inf)
_LIMITS[COLUMNS.index("vf")] = LIMIT_MPS
_LIMITS[COLUMNS.index("vl")] = LIMIT_MPS
_LIMITS[COLUMNS.index("wu")] = LIMIT_RADPS
# Radius of the earth at the equator in metres.
EARTH_RADIUS_M = 6378137.0
# File of recorded speeds and yaw rates in a drive's folder, which KITTI itself lacks.
MOTION_FILE = "motion.csv"
# File of recorded angles of the front wheels there.
STEERING = "steering.csv"
# Columns of these files, beside the frame's number → their largest plausible magnitudes.
VALUE_FILES = {
    MOTION_FILE: {"speed_mps": LIMIT_MPS, "yaw_rate_radps": LIMIT_RADPS},
    STEERING: {"steering_rad": LIMIT_RAD},
}


def make_packets(frames: int, **columns: np.ndarray | float) -> np.ndarray:
    """Return packets, float64 [F,30], from named columns [F] or constants; other columns are 0."""
    rows = np.zeros((frames, len(COLUMNS)))
    for name, values in columns.items():
        rows[:, COLUMNS.index(name)] = values
    return rows


def is_interpolated(rows: np.ndarray) -> np.ndarray:
    """Return which packets [F,30] KITTI interpolated, bool [F].

    In such a packet, the mode of position, velocity or orientation is -1. Labels from the
    interpolated packets of 2011_10_03_drive_0027 are off by 0.04 rad rms, those from its other
    packets by 0.006.
    """
    modes = rows[:, COLUMNS.index("posmode") :]
    return np.asarray((modes == -1).any(axis=1))


def extract_motion(packets: Mapping[int, np.ndarray]) -> dict[str, dict[int, float]]:
    """Return name → frame number → value, for the names of MOTION.

    `packets` maps frame numbers to packets [30]. Values are in m/s and rad/s, left positive. They
    are NaN for an interpolated packet, which is no measurement.
    """
    motion: dict[str, dict[int, float]] = {name: {} for name in MOTION}
    for number, row in packets.items():
        is_measured = not is_interpolated(row[None])[0]
        for name, column in MOTION.items():
            motion[name][number] = float(row[column]) if is_measured else np.nan
    return motion


def format_packet(row: np.ndarray) -> bytes:
    """Return the content of a packet's file for a row [30]."""
    words = [f"{value:.13g}" for value in row[:_COUNTS]]
    words += [f"{value:.0f}" for value in row[_COUNTS:]]
    return (" ".join(words) + "\n").encode("ascii")


def format_times(time_s: np.ndarray, date: str, start_s: float) -> bytes:
    """Return the content of ``timestamps.txt`` for times [F] in seconds.

    Time 0 is `start_s` after midnight of `date`, for instance 2026_01_01.
    """
    midnight = np.datetime64(date.replace("_", "-"), "ns")
    since_midnight = np.rint((start_s + time_s) * 1e9).astype("timedelta64[ns]")
    lines = [f"{stamp}\n".replace("T", " ") for stamp in midnight + since_midnight]
    return "".join(lines).encode("ascii")


def read_packet(path: Path) -> np.ndarray:
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
    """Return the times of `frames` in seconds since the first, float64 [F].

    `frames` are KITTI frame numbers, ascending. Line i of ``timestamps.txt``, counted from 0,
    belongs to frame i. If a drive was cut out of a longer one, the file may have exactly one line
    per frame: in this case, line i belongs to ``frames[i]``. Raises InputError if the file or a
    line is missing, or if time does not increase.
    """
    if not path.is_file():
        raise InputError(
            "file is missing", path, f"Extract the drive's {path.parent.name} folder again"
        )
    lines = _read_lines(path)
    numbers = _line_numbers(len(lines), frames)
    if numbers[-1] > len(lines):
        raise InputError(
            f"expected at least {frames[-1] + 1} lines for frame {frames[-1]}, got {len(lines)}",
            path,
        )
    words = lines.loc[numbers]
    stamps = _to_stamps(words)
    refuse_faults(list_fault(words[stamps.isna()], "is not a date and time"), path, "Correct it")
    # Subtract in integer nanoseconds: a float64 resolves the seconds since 1970 only to 0.2
    # microseconds.
    time_s = (stamps - stamps.iloc[0]).astype("int64") / 1e9
    refuse_faults(check_increase(time_s, 1e-9), path, "Correct or remove it")
    return time_s.to_numpy()


def read_stamps(path: Path, frames: Sequence[int]) -> pd.Series:
    """Return frame number → time stamp of the `frames` that have one in a ``timestamps.txt``.

    Its lines belong to frames as in :func:`read_times`.
    """
    lines = _read_lines(path)
    stamps = _to_stamps(lines.reindex(_line_numbers(len(lines), frames)))
    return stamps.set_axis(frames).dropna()


def _read_lines(path: Path) -> pd.Series:
    """Return number of the line, counted from 1 → line of a file."""
    lines = path.read_text("ascii", errors="replace").rstrip().split("\n")
    return pd.Series(lines, np.arange(len(lines)) + 1, name="time")


def _line_numbers(lines: int, frames: Sequence[int]) -> list[int]:
    """Return the number, counted from 1, of the line of each frame in a file of so many `lines`."""
    if len(frames) == lines <= frames[-1]:
        return list(range(1, lines + 1))
    return [frame + 1 for frame in frames]


def _to_stamps(words: pd.Series) -> pd.Series:
    """Convert texts to UTC, or to NaT where they are not a date and time."""
    stamps = pd.to_datetime(words, format="ISO8601", errors="coerce", utc=True)
    return stamps.dt.tz_localize(None).astype("datetime64[ns]")


def read_values(path: Path) -> dict[str, dict[int, float]]:
    """Return name → frame number → value of the file MOTION_FILE or STEERING of a drive.

    Frames with an empty cell are left out. Raises InputError.
    """
    limits = VALUE_FILES[path.name]
    expected = f"Expected CSV: frame (number of the image), {', '.join(limits)} (left +)"
    table, faults = read_columns(path, {"frame": np.inf, **limits}, expected)
    frame = table["frame"]
    faults += list_fault(frame[frame % 1 > 0], "is not a whole number")
    refuse_faults(faults + check_increase(frame, 1), path, expected)
    by_frame = table.dropna().astype({"frame": int}).set_index("frame")
    return {name: by_frame[name].to_dict() for name in limits}


def write_values(path: Path, frames: Sequence[int], values: Mapping[str, np.ndarray]) -> None:
    """Write name → value [F] of frames with F numbers as :func:`read_values` reads it.

    An unknown value, NaN, is an empty cell.
    """
    table = pd.DataFrame(values, index=frames)
    table.to_csv(path, index_label="frame", float_format="%.9f")
