"""Read logs of a car, its motion and the angles of its steering wheel, and interpolate them at the times of images."""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from pipeline.base.errors import InputError
from pipeline.kitti.columns import check_limit, read_columns
from pipeline.kitti.oxts import LIMITS, check_angles
from pipeline.video.recording import check_times

MAX_GAP_S = 2.0  # between samples that are interpolated
ROUNDING_S = 1e-3  # of timestamps in videos; comparisons tolerate it
_MOTION = "Expected a CSV file with time_s [s], speed_mps [m/s] and yaw_rate_radps [rad/s, left +]"
_WHEEL = "Expected a CSV file with time_s [s] and wheel_rad [rad, left +]"


class Log(NamedTuple):
    """Samples at ascending times [N] of C quantities [C,N]."""

    time_s: np.ndarray
    samples: np.ndarray

    def at(self, time_s: np.ndarray) -> np.ndarray:
        """Return quantities [C,F] at `time_s` [F], linear between samples, NaN outside and in gaps over MAX_GAP_S."""
        left = np.clip(np.searchsorted(self.time_s, time_s, side="right") - 1, 0, len(self.time_s) - 2)
        before_s, after_s = self.time_s[left], self.time_s[left + 1]
        gap_s = np.where((time_s == before_s) | (time_s == after_s), 0.0, after_s - before_s)
        inside = (time_s >= self.time_s[0] - ROUNDING_S) & (time_s <= self.time_s[-1] + ROUNDING_S)
        values = np.stack([np.interp(time_s, self.time_s, samples) for samples in self.samples])
        return np.where(inside & (gap_s <= MAX_GAP_S + ROUNDING_S), values, np.nan)


class Logs(NamedTuple):
    """A log of the front wheels' angle in rad, one of speed and yaw rate (left +), and the names of their files."""

    wheel: Log | None = None
    motion: Log | None = None
    name: str = ""

    @classmethod
    def read(
        cls, wheel: Path | None, steering_ratio: float | None, motion: Path | None, offset_s: float = 0.0
    ) -> "Logs":
        """Read a log of the steering wheel's angles, its ratio to the front wheels', and a log of the motion.

        `offset_s` is added to their times. Raises InputError for unusable logs.
        """
        if (wheel is None) != (steering_ratio is None):
            fix = "Pass both; a ratio of 1 if the log holds angles of the front wheels"
            raise InputError("--wheel and --steering-ratio need each other", fix=fix)
        name = " and ".join(path.name for path in (wheel, motion) if path)
        angles = read_wheel(wheel, steering_ratio, offset_s) if wheel and steering_ratio else None
        return cls(angles, read_motion(motion, offset_s) if motion else None, name)


def read_motion(path: Path, offset_s: float = 0.0) -> Log:
    """Read a CSV file with the columns time_s, speed_mps and yaw_rate_radps; `offset_s` is added to its times.

    Raises InputError if a column is missing, values are implausible, or times do not increase or are not in seconds.
    """
    time_s, *samples = read_columns(path, ("time_s", "speed_mps", "yaw_rate_radps"), _MOTION).values()
    check_times(time_s, path)
    check_limit("speed_mps", samples[0], LIMITS["vf"], path)
    check_limit("yaw_rate_radps", samples[1], LIMITS["wu"], path)
    return Log(time_s + offset_s, np.stack(samples))


def read_wheel(path: Path, steering_ratio: float, offset_s: float = 0.0) -> Log:
    """Read a CSV file with time_s and wheel_rad, left positive, and divide by the steering ratio.

    `offset_s` is added to the times. Raises InputError as :func:`read_motion` does.
    """
    time_s, wheel_rad = read_columns(path, ("time_s", "wheel_rad"), _WHEEL).values()
    check_angles(wheel_rad / steering_ratio, path)
    check_times(time_s, path)
    return Log(time_s + offset_s, wheel_rad[None] / steering_ratio)
