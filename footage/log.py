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
    fault,
    read_columns,
    refuse,
)

# Largest distance in seconds between two logged values for an interpolation between them.
MAX_GAP_S = 0.5
# Least difference in radians between two successive values that is a jump from 2π to 0. No wheel
# turns this fast.
WRAPPED_RAD = 5.0
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
    """C quantities of the car at N times, and their file."""

    time_s: np.ndarray  # ascending [N]
    values: np.ndarray  # [C,N], NaN where unknown
    name: str = ""  # name of the file

    def at(self, time_s: np.ndarray) -> np.ndarray:
        """Return the quantities [C,F] at `time_s` [F], interpolated linearly.

        They are NaN before the first and after the last logged time, between times that are more
        than MAX_GAP_S apart, and wherever one of the quantities is NaN.
        """
        left = np.searchsorted(self.time_s, time_s, side="right") - 1
        left = np.clip(left, 0, len(self.time_s) - 2)
        before_s = self.time_s[left]
        after_s = self.time_s[left + 1]
        # At a time that is logged itself, a gap does not matter.
        is_logged = (time_s == before_s) | (time_s == after_s)
        gap_s = np.where(is_logged, 0.0, after_s - before_s)

        values = np.stack([np.interp(time_s, self.time_s, row) for row in self.values])
        inside = (time_s >= self.time_s[0] - ROUNDING_S) & (time_s <= self.time_s[-1] + ROUNDING_S)
        is_known = inside & (gap_s <= MAX_GAP_S + ROUNDING_S) & np.isfinite(values).all(axis=0)
        return np.where(is_known, values, np.nan)

    def check_overlap(self, first_s: float, last_s: float) -> None:
        """Raise InputError if the log ends before the first image, or begins after the last."""
        begin_s, end_s = self.time_s[[0, -1]]
        if begin_s > last_s + ROUNDING_S or end_s < first_s - ROUNDING_S:
            offset = f"--offset {round(first_s - begin_s, 3):.13g}, added to an earlier one"
            raise InputError(
                f"log is from {begin_s:.1f} to {end_s:.1f} s, the images from {first_s:.1f} to "
                f"{last_s:.1f} s",
                self.name,
                f"If both begin together, pass {offset}",
            )


# The logs of a recording by name: "motion" has speed in m/s and yaw rate in rad/s, "wheel" the
# front wheels' angle in rad, all left positive.
Logs = Mapping[str, Log]


def read_logs(options: Options) -> Logs:
    """Read the logs of a recording, CSV files of the car's motion and of the wheel's angle.

    A log of the motion has the columns time_s, speed_mps and yaw_rate_radps; a log of the wheel has
    time_s and wheel_rad. The offset is added to the times. Empty cells are interpolated, and
    repeated rows are left out. Raises InputError with all faults of a file. The times of a column
    have to increase, and to be in seconds.
    """
    if (options.wheel is None) != (options.steering_ratio is None):
        fix = "Pass both. 1: the log holds angles of the front wheels"
        raise InputError("--wheel and --steering-ratio need each other", fix=fix)
    if options.offset_s and not (options.wheel or options.motion):
        raise InputError("--offset needs a log", fix="Pass --motion or --wheel, too")

    logs = dict[str, Log]()
    if options.motion:
        logs["motion"] = _read_log(options.motion, _RATES, _MOTION, options.offset_s)
    if options.wheel and options.steering_ratio:
        logs["wheel"] = _read_wheel(options.wheel, options.steering_ratio, options.offset_s)
    return logs


def _read_wheel(path: Path, ratio: float, offset_s: float) -> Log:
    """Return the front wheels' angle from a log of the steering wheel's angle.

    The steering wheel's angle is `ratio` times the front wheels'.
    """
    log = _read_log(path, {"wheel_rad": LIMIT_RAD * abs(ratio)}, _WHEEL, offset_s)
    largest_step = np.nanmax(np.abs(np.diff(log.values)))
    if np.nanmin(log.values) >= 0 and largest_step > WRAPPED_RAD:
        raise InputError("wheel_rad is 0 to 2π: angles jump by a turn", path, "Subtract 2π above π")
    return log._replace(values=log.values / ratio)


def logged_values(logs: Logs, time_s: np.ndarray) -> dict[str, np.ndarray]:
    """Return name → value at `time_s` [F], NaN where unknown.

    Where speed or yaw rate is unknown, both are.
    """
    values = dict[str, np.ndarray]()
    if "motion" in logs:
        values["speed_mps"], values["yaw_rate_radps"] = logs["motion"].at(time_s)
    if "wheel" in logs:
        (values["steering_rad"],) = logs["wheel"].at(time_s)
    return values


def range_note(name: str, values: np.ndarray) -> str:
    """Return a note on the values [F] of a log at the images' times."""
    known = values[np.isfinite(values)]
    note = f"{name} is known at {len(known):,} of {len(values):,} images"
    if len(known):
        note += f": {known.min():z.3f} to {known.max():z.3f}"
    return note


def _read_log(path: Path, limits: Mapping[str, float], expected: str, offset_s: float) -> Log:
    """Return a file as a log. `limits` and `expected` are those of :func:`read_columns`."""
    rows, faults = read_columns(path, {"time_s": np.inf, **limits}, expected)
    table = rows.drop_duplicates()
    columns = {name: table[["time_s", name]].dropna(subset=name) for name in limits}
    for name, column in columns.items():
        faults += _check_times(column["time_s"], MAX_GAP_S + ROUNDING_S, name)
    refuse(faults, path, expected)

    # Quantities of two sensors in one file have different times, so each column is interpolated at
    # all times of the file.
    time_s = np.unique(table["time_s"])
    values = []
    for column in columns.values():
        column_time_s, column_values = column.to_numpy().T
        values.append(Log(column_time_s, column_values[None]).at(time_s))
    return Log(time_s + offset_s, np.concatenate(values), path.name)


def read_times(path: Path) -> np.ndarray:
    """Read the times of images, one number in seconds per line, float64 [F]. Raises InputError."""
    words = pd.Series(path.read_text("utf-8-sig", errors="replace").split(), name="time", dtype=str)
    words.index += 1
    times_s = pd.to_numeric(words, errors="coerce").astype(float)
    faults = fault(words[times_s.isna()], "is not a number")
    faults += _check_times(times_s, LONGEST_STEP_S)
    refuse(faults, path, "Expected one number per line, in seconds")
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
        faults += fault(
            times_s.head(1),
            f"has a median step of {step_s:g} (expected 0.001 to {longest_s:.1g} s: divide "
            "milliseconds by 1000, nanoseconds by 1e9; values farther apart are not interpolated)",
        )
    return faults
