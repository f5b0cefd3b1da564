"""Read logs of a car's motion and of its wheel's angles, and interpolate them at images' times."""

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd

from footage.settings import Options
from pipeline.base.errors import InputError
from pipeline.ingest.columns import (
    LIMIT_MPS,
    LIMIT_RAD,
    LIMIT_RADPS,
    check_increase,
    list_fault,
    read_columns,
    refuse_faults,
)

# Largest distance in seconds between two logged values for an interpolation between them.
MAX_GAP_S = 0.5
# Error in seconds of timestamps in videos, which are rounded. Comparisons tolerate it.
ROUNDING_S = 1e-3
# Least difference in seconds between the times of successive rows.
LEAST_STEP_S = 1e-5
# Least median step in seconds. If it is smaller, the times are in another unit than seconds.
LEAST_MEDIAN_S = 0.999e-3
# Largest median step in seconds between images. If it is larger, the times are in another unit: in
# milliseconds, the step is 10 or more.
LONGEST_STEP_S = 2.0
# Columns of a log of the motion → their largest plausible magnitudes.
_RATES = {"speed_mps": LIMIT_MPS, "yaw_rate_radps": LIMIT_RADPS}
# Advice for a faulty log of the motion.
_MOTION = (
    "Expected CSV, numbers with decimal points: time_s [s], speed_mps [m/s], yaw_rate_radps "
    "[rad/s, left +]"
)
# Advice for a faulty log of the wheel.
_WHEEL = "Expected CSV, numbers with decimal points: time_s [s], wheel_rad [rad, left +]"


class Log(NamedTuple):
    """A quantity of the car at N times, and the name of its file."""

    time_s: np.ndarray  # ascending [N]
    values: np.ndarray  # [N]
    name: str = ""

    def interpolate(self, time_s: np.ndarray) -> np.ndarray:
        """Return the quantity [F] at `time_s` [F], interpolated linearly.

        It is NaN before the first and after the last logged time, and between times that are more
        than MAX_GAP_S apart.
        """
        right = np.searchsorted(self.time_s, time_s).clip(1, len(self.time_s) - 1)
        gap_s = self.time_s[right] - self.time_s[right - 1]
        # At a time that is logged itself, a gap does not matter.
        is_known = (gap_s <= MAX_GAP_S + ROUNDING_S) | (time_s == self.time_s[right])
        is_known &= time_s >= self.time_s[0] - ROUNDING_S
        is_known &= time_s <= self.time_s[-1] + ROUNDING_S
        return np.where(is_known, np.interp(time_s, self.time_s, self.values), np.nan)

    def check_overlap(self, first_s: float, last_s: float, files: int = 1) -> None:
        """Raise InputError if the log ends before the first image, or begins after the last.

        If the images are in several `files`, which may have gaps, no offset is advised.
        """
        begin_s, end_s = self.time_s[[0, -1]]
        if begin_s > last_s or end_s < first_s:
            offset = f"--offset {round(first_s - begin_s, 3):.13g}, added to an earlier one"
            fix = f"If both begin together, pass {offset}"
            if files > 1:
                fix = "Pass --times FILE, the seconds of each image by the clock of the log"
            raise InputError(
                f"log is from {begin_s:.1f} to {end_s:.1f} s, the images from {first_s:.1f} to "
                f"{last_s:.1f} s",
                self.name,
                fix,
            )


def read_logs(options: Options) -> dict[str, Log]:
    """Read the logs of a recording: column of a drive's files → log, left positive.

    A CSV file of the motion has the columns time_s, speed_mps and yaw_rate_radps; one of the wheel
    has time_s and wheel_rad, which is divided by the steering ratio. The offset is added to the
    times. Empty cells are interpolated, and repeated rows are left out. Raises InputError with all
    faults of a file.
    """
    if bool(options.wheel) != bool(options.steering_ratio):
        fix = "Pass both. 1: the log holds angles of the front wheels"
        raise InputError("--wheel and --steering-ratio need each other", fix=fix)
    if options.offset_s and not (options.wheel or options.motion):
        raise InputError("--offset needs a log", fix="Pass --motion or --wheel, too")

    logs = dict[str, Log]()
    if options.motion:
        logs |= _read_log(options.motion, _RATES, _MOTION, options.offset_s)
    if options.wheel and options.steering_ratio:
        limits = {"wheel_rad": LIMIT_RAD * abs(options.steering_ratio)}
        wheel = _read_log(options.wheel, limits, _WHEEL, options.offset_s)["wheel_rad"]
        logs["steering_rad"] = wheel._replace(values=wheel.values / options.steering_ratio)
    return logs


def _read_log(
    path: Path, limits: Mapping[str, float], expected: str, offset_s: float
) -> dict[str, Log]:
    """Return the columns of a file. `limits` and `expected` are those of :func:`read_columns`."""
    table, faults = read_columns(path, {"time_s": np.inf, **limits}, expected)
    # Quantities of two sensors in one file have different times.
    logs = {}
    for name in limits:
        column = table[["time_s", name]].dropna(subset=name).drop_duplicates()
        faults += _check_times(column["time_s"], MAX_GAP_S + ROUNDING_S, name)
        time_s, values = column.to_numpy().T
        logs[name] = Log(time_s + offset_s, values, path.name)
    refuse_faults(faults, path, expected)
    return logs


def read_times(path: Path) -> np.ndarray:
    """Read the times of images, one number in seconds per line, float64 [F]. Raises InputError."""
    words = pd.Series(path.read_text("utf-8-sig", errors="replace").split(), name="time", dtype=str)
    words.index += 1
    times_s = pd.to_numeric(words, errors="coerce").astype(float)
    faults = list_fault(words[times_s.isna()], "is not a number")
    faults += _check_times(times_s, LONGEST_STEP_S)
    refuse_faults(faults, path, "Expected one number per line, in seconds")
    return times_s.to_numpy()


def _check_times(times_s: pd.Series, longest_s: float, column: str = "") -> list[str]:
    """Return faults of the times of a `column`.

    It is a fault if there are fewer than two times, if they do not increase, or if their median
    step is below 1 ms or above `longest_s`.
    """
    if len(times_s) < 2:
        return [f"{column or times_s.name} has fewer than 2 values"]
    faults = check_increase(times_s, LEAST_STEP_S)
    step_s = float(times_s.diff().median())
    if 0 < step_s < LEAST_MEDIAN_S or step_s > longest_s:
        faults += list_fault(
            times_s.head(1),
            f"has a median step of {step_s:g} (expected 0.001 to {longest_s:.1g} s: divide "
            "milliseconds by 1000, nanoseconds by 1e9; values farther apart are not interpolated)",
        )
    return faults
