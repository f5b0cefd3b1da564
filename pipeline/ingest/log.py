"""Read logs of a car, its motion and the angles of its steering wheel, and interpolate them at the times of images."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd

from pipeline.base.errors import InputError
from pipeline.ingest.columns import LIMIT_MPS, LIMIT_RAD, LIMIT_RADPS, read_columns, refuse
from pipeline.ingest.media import check_times
from pipeline.ingest.names import check_name

MAX_GAP_S = 0.5  # between values that are interpolated
WRAPPED_RAD = 5.0  # between two values: no wheel turns this fast
ROUNDING_S = 1e-3  # of timestamps in videos; comparisons tolerate it
_RATES = {"speed_mps": LIMIT_MPS, "yaw_rate_radps": LIMIT_RADPS}
_MOTION = "Expected CSV, numbers with decimal points: time_s [s], speed_mps [m/s], yaw_rate_radps [rad/s, left +]"
_WHEEL = "Expected CSV, numbers with decimal points: time_s [s], wheel_rad [rad, left +]"


class Log(NamedTuple):
    """Values [C,N] of C quantities at ascending times [N], NaN where unknown, and their file."""

    time_s: np.ndarray
    values: np.ndarray
    name: str = ""
    repeated: int = 0  # rows of the file that equal another one and are left out
    ratio: float = 1.0  # by which the file's values were divided

    def at(self, time_s: np.ndarray) -> np.ndarray:
        """Return quantities [C,F] at `time_s` [F], linear between times; NaN outside, and in gaps of any quantity."""
        left = np.clip(np.searchsorted(self.time_s, time_s, side="right") - 1, 0, len(self.time_s) - 2)
        before_s, after_s = self.time_s[left], self.time_s[left + 1]
        gap_s = np.where((time_s == before_s) | (time_s == after_s), 0.0, after_s - before_s)
        inside = (time_s >= self.time_s[0] - ROUNDING_S) & (time_s <= self.time_s[-1] + ROUNDING_S)
        values = np.stack([np.interp(time_s, self.time_s, row) for row in self.values])
        known = inside & (gap_s <= MAX_GAP_S + ROUNDING_S) & np.isfinite(values).all(axis=0)
        return np.where(known, values, np.nan)


class Logs(NamedTuple):
    """A log of the front wheels' angle in rad, and one of speed and yaw rate (left +)."""

    wheel: Log | None = None
    motion: Log | None = None

    @classmethod
    def read(
        cls, wheel: Path | None, steering_ratio: float | None, motion: Path | None, offset_s: float = 0.0
    ) -> "Logs":
        """Read a log of the steering wheel's angles, its ratio to the front wheels', and a log of the motion.

        They are CSV files with time_s and wheel_rad, left positive, and with time_s, speed_mps and yaw_rate_radps.
        `offset_s` is added to their times. Empty cells are interpolated, and repeated rows left out. Raises InputError
        with all faults of a file; times of a column have to increase and to be in seconds.
        """
        if (wheel is None) != (steering_ratio is None):
            fix = "Pass both; a ratio of 1 if the log holds angles of the front wheels"
            raise InputError("--wheel and --steering-ratio need each other", fix=fix)
        if offset_s and not (wheel or motion):
            raise InputError("--offset needs a log", fix="Pass --motion or --wheel, too")
        angles, rates = None, _read(motion, _RATES, _MOTION, offset_s) if motion else None
        if wheel and steering_ratio is not None:
            if not abs(steering_ratio) >= 1:
                raise InputError("expected a magnitude of 1 or more", "--steering-ratio", "1: angles of front wheels")
            angles = _read(wheel, {"wheel_rad": LIMIT_RAD * abs(steering_ratio)}, _WHEEL, offset_s)
            if np.nanmin(angles.values) >= 0 and np.nanmax(np.abs(np.diff(angles.values))) > WRAPPED_RAD:
                raise InputError("wheel_rad is 0 to 2π: angles jump by a turn", wheel, "Subtract 2π above π")
            angles = angles._replace(values=angles.values / steering_ratio, ratio=steering_ratio)
        return cls(angles, rates)

    @property
    def name(self) -> str:
        """The names of the files, empty without a log."""
        return " and ".join(log.name for log in self if log)

    def values(self, frame: np.ndarray, time_s: np.ndarray) -> dict[str, dict[int, float]]:
        """Return name → frame number → value, for the frames [F] at `time_s` [F].

        Unknown rates are NaN, unknown angles are left out; see Drive.
        """
        columns = zip(_RATES, self.motion.at(time_s), strict=True) if self.motion else ()
        result = {name: dict(zip(frame.tolist(), column.tolist(), strict=True)) for name, column in columns}
        if self.wheel:
            result["steering_rad"] = pd.Series(self.wheel.at(time_s)[0], frame).dropna().to_dict()
        return result

    def check_overlap(self, first_s: float, last_s: float) -> None:
        """Raise InputError for a log without a value from the first to the last image."""
        for log in filter(None, self):
            begin_s, end_s = log.time_s[[0, -1]]
            if begin_s > last_s + ROUNDING_S or end_s < first_s - ROUNDING_S:
                problem = f"log is from {begin_s:.1f} to {end_s:.1f} s, the images from {first_s:.1f} to {last_s:.1f} s"
                offset = f"--offset {round(first_s - begin_s, 3):.13g}, added to an earlier one"
                raise InputError(problem, log.name, f"If both begin together, pass {offset}")

    def notes(self, time_s: np.ndarray) -> Iterator[str]:
        """Yield a line for each log with repeated rows, and for each without a value of all images, at `time_s` [F]."""
        for log in filter(None, self):
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
        faults += check_times(column["time_s"], MAX_GAP_S + ROUNDING_S, name)
    refuse(faults, path, expected)
    time_s = np.unique(table["time_s"])  # two topics in one file have their own times
    own = [Log(times_s, values[None]).at(time_s) for times_s, values in (one.to_numpy().T for one in columns.values())]
    return Log(time_s + offset_s, np.concatenate(own), path.name, len(rows) - len(table))
