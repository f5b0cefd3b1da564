"""Read logs of a car, its motion and the angles of its steering wheel, and interpolate them at the
times of images.
"""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd

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
from pipeline.ingest.names import check_name
from pipeline.ingest.settings import RecordingOptions

MAX_GAP_S = 0.5  # between values that are interpolated
WRAPPED_RAD = 5.0  # between two values: no wheel turns this fast
ROUNDING_S = 1e-3  # of timestamps in videos; comparisons tolerate it
_RATES = {"speed_mps": LIMIT_MPS, "yaw_rate_radps": LIMIT_RADPS}
_MOTION = (
    "Expected CSV, numbers with decimal points: time_s [s], speed_mps [m/s], yaw_rate_radps "
    "[rad/s, left +]"
)
_WHEEL = "Expected CSV, numbers with decimal points: time_s [s], wheel_rad [rad, left +]"


class Log(NamedTuple):
    """Values [C,N] of C quantities at ascending times [N], NaN where unknown, and their file."""

    time_s: np.ndarray
    values: np.ndarray
    name: str = ""
    repeated: int = 0  # rows of the file that equal another one and are left out
    ratio: float = 1.0  # by which the file's values were divided

    def at(self, time_s: np.ndarray) -> np.ndarray:
        """Return quantities [C,F] at `time_s` [F], linear between times; NaN outside, and in gaps
        of any quantity.
        """
        left = np.clip(
            np.searchsorted(self.time_s, time_s, side="right") - 1, 0, len(self.time_s) - 2
        )
        before_s, after_s = self.time_s[left], self.time_s[left + 1]
        gap_s = np.where((time_s == before_s) | (time_s == after_s), 0.0, after_s - before_s)
        inside = (time_s >= self.time_s[0] - ROUNDING_S) & (time_s <= self.time_s[-1] + ROUNDING_S)
        values = np.stack([np.interp(time_s, self.time_s, row) for row in self.values])
        known = inside & (gap_s <= MAX_GAP_S + ROUNDING_S) & np.isfinite(values).all(axis=0)
        return np.where(known, values, np.nan)

    def check_overlap(self, first_s: float, last_s: float) -> None:
        """Raise InputError if there is no value from the first to the last image."""
        begin_s, end_s = self.time_s[[0, -1]]
        if begin_s > last_s + ROUNDING_S or end_s < first_s - ROUNDING_S:
            problem = (
                f"log is from {begin_s:.1f} to {end_s:.1f} s, the images from {first_s:.1f} to "
                f"{last_s:.1f} s"
            )
            offset = f"--offset {round(first_s - begin_s, 3):.13g}, added to an earlier one"
            raise InputError(problem, self.name, f"If both begin together, pass {offset}")


# The logs of a recording: "wheel", of the front wheels' angle in rad, and "motion", of speed and
# yaw rate (left +).
Logs = Mapping[str, Log]


def read_logs(options: RecordingOptions) -> Logs:
    """Read the logs of a recording: CSV files with time_s and wheel_rad, and with time_s,
    speed_mps, yaw_rate_radps.

    The offset is added to their times. Empty cells are interpolated, and repeated rows left out.
    Raises InputError with all faults of a file; times of a column have to increase and to be in
    seconds.
    """
    ratio = options.steering_ratio
    if (options.wheel is None) != (ratio is None):
        fix = "Pass both; a ratio of 1 if the log holds angles of the front wheels"
        raise InputError("--wheel and --steering-ratio need each other", fix=fix)
    if options.offset_s and not (options.wheel or options.motion):
        raise InputError("--offset needs a log", fix="Pass --motion or --wheel, too")
    motion = _read(options.motion, _RATES, _MOTION, options.offset_s) if options.motion else None
    logs = dict[str, Log]()
    if options.wheel and ratio is not None:
        if not abs(ratio) >= 1:
            raise InputError(
                "expected a magnitude of 1 or more", "--steering-ratio", "1: angles of front wheels"
            )
        angles = _read(
            options.wheel, {"wheel_rad": LIMIT_RAD * abs(ratio)}, _WHEEL, options.offset_s
        )
        if (
            np.nanmin(angles.values) >= 0
            and np.nanmax(np.abs(np.diff(angles.values))) > WRAPPED_RAD
        ):
            raise InputError(
                "wheel_rad is 0 to 2π: angles jump by a turn", options.wheel, "Subtract 2π above π"
            )
        logs["wheel"] = angles._replace(values=angles.values / ratio, ratio=ratio)
    if motion:
        logs["motion"] = motion
    return logs


def log_names(logs: Logs) -> str:
    """Return the names of the files, empty without a log."""
    return " and ".join(log.name for log in logs.values())


def logged_values(logs: Logs, frame: np.ndarray, time_s: np.ndarray) -> dict[str, dict[int, float]]:
    """Return name → frame number → value, for the frames [F] at `time_s` [F].

    Unknown rates are NaN, unknown angles are left out; see Drive.
    """
    result = dict[str, dict[int, float]]()
    if "motion" in logs:
        for name, column in zip(_RATES, logs["motion"].at(time_s), strict=True):
            result[name] = dict(zip(frame.tolist(), column.tolist(), strict=True))
    if "wheel" in logs:
        result["steering_rad"] = pd.Series(logs["wheel"].at(time_s)[0], frame).dropna().to_dict()
    return result


def log_notes(logs: Logs, time_s: np.ndarray) -> Iterator[str]:
    """Yield a line for each log with repeated rows, and for each without a value of all images, at
    `time_s` [F].
    """
    for log in logs.values():
        if log.repeated:
            yield f"{log.name}: {log.repeated:,} rows repeat another row and are left out"
        if not (known := np.isfinite(log.at(time_s)[0])).all():
            yield f"{log.name} covers {known.sum():,} of {len(known):,} images"


def _read(path: Path, limits: Mapping[str, float], expected: str, offset_s: float) -> Log:
    check_name(path)
    rows, faults = read_columns(path, {"time_s": np.inf, **limits}, expected)
    table = rows.drop_duplicates()
    columns = {name: table[["time_s", name]].dropna(subset=name) for name in limits}
    for name, column in columns.items():
        faults += _check_times(column["time_s"], MAX_GAP_S + ROUNDING_S, name)
    refuse(faults, path, expected)
    time_s = np.unique(table["time_s"])  # two topics in one file have their own times
    own = [
        Log(times_s, values[None]).at(time_s)
        for times_s, values in (one.to_numpy().T for one in columns.values())
    ]
    return Log(time_s + offset_s, np.concatenate(own), path.name, len(rows) - len(table))


def read_times(path: Path) -> np.ndarray:
    """Return the times of images, one number in seconds per line, float64 [F]. Raises
    InputError.
    """
    check_name(path)
    words = pd.Series(path.read_text("utf-8-sig", errors="replace").split(), name="time", dtype=str)
    words.index += 1
    times_s = pd.to_numeric(words, errors="coerce").astype(float)
    # Of milliseconds, steps are 10 and more.
    faults = fault(words[times_s.isna()], "is not a number") + _check_times(times_s, 2.0)
    refuse(faults, path, "Expected one number per line, in seconds")
    return times_s.to_numpy()


def _check_times(times_s: pd.Series, longest_s: float, column: str = "") -> list[str]:
    """Return faults of the times of a `column`: too few, no increase, a median step below 1 ms or
    above `longest_s`.
    """
    if len(times_s) < 2:
        return [f"{column or times_s.name} has fewer than 2 values"]
    faults = check_increase(times_s, 1e-5)
    step_s = float(times_s.diff().median())
    if 0 < step_s < 0.999e-3 or step_s > longest_s:
        units = (
            "divide milliseconds by 1000, nanoseconds by 1e9; values farther apart are not "
            "interpolated"
        )
        expected = f"expected 0.001 to {longest_s:.1g} s: {units}"
        faults += fault(times_s.head(1), f"has a median step of {step_s:g} ({expected})")
    return faults
