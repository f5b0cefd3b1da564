"""Read logs of a car, its motion and the angles of its steering wheel, and interpolate them at the times of images."""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from pipeline.base.errors import InputError
from pipeline.kitti.columns import check_limit, read_columns
from pipeline.kitti.oxts import LIMITS, check_angles, check_frames
from pipeline.video.recording import check_times

MAX_GAP_S = 2.0  # between samples that are interpolated
ROUNDING_S = 1e-3  # of timestamps in videos; comparisons tolerate it
_MOTION = "Expected a CSV file with time_s [s], speed_mps [m/s] and yaw_rate_radps [rad/s, left +]"
_WHEEL = "Expected a CSV file with wheel_rad [rad, left +] and time_s [s] or frame (number of the image)"


class MotionLog(NamedTuple):
    """Samples of a car's motion, all [N], times ascending, yaw rate left positive."""

    time_s: np.ndarray
    speed_mps: np.ndarray
    yaw_rate_radps: np.ndarray

    def at(self, time_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return speed and yaw rate at `time_s` [F], see :func:`interpolate`."""
        speed_mps = interpolate(time_s, self.time_s, self.speed_mps)
        return speed_mps, interpolate(time_s, self.time_s, self.yaw_rate_radps)


class WheelLog(NamedTuple):
    """Angles of the front wheels in rad, left positive, with times or with numbers of images; all [N], ascending."""

    path: Path
    steering_rad: np.ndarray
    time_s: np.ndarray | None
    frame: np.ndarray | None

    def at(self, number: np.ndarray, time_s: np.ndarray) -> np.ndarray:
        """Return the angles [F] of images with these numbers and times [F]; NaN where unknown."""
        if self.time_s is not None:
            return interpolate(time_s, self.time_s, self.steering_rad)
        assert self.frame is not None
        at = np.minimum(np.searchsorted(self.frame, number), len(self.frame) - 1)
        return np.where(self.frame[at] == number, self.steering_rad[at], np.nan)

    def check_frames(self, last: int) -> None:
        """Raise InputError if the log has an angle of an image after the `last` one."""
        if self.frame is not None and self.frame[-1] > last:
            problem = f"has frame {self.frame[-1]}, but the last image is {last}"
            raise InputError(problem, self.path, "Number the images from 0, or give time_s instead of frame")


class Logs(NamedTuple):
    """A log of the front wheels' angles, one of the car's motion, and the names of their files."""

    wheel: WheelLog | None = None
    motion: MotionLog | None = None
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


def interpolate(time_s: np.ndarray, samples_s: np.ndarray, samples: np.ndarray) -> np.ndarray:
    """Interpolate samples [N] of ascending times [N] at `time_s` [F]; NaN outside and in gaps over MAX_GAP_S."""
    left = np.clip(np.searchsorted(samples_s, time_s, side="right") - 1, 0, len(samples_s) - 2)
    gap_s = samples_s[left + 1] - samples_s[left]
    gap_s[(time_s == samples_s[left]) | (time_s == samples_s[left + 1])] = 0.0
    inside = (time_s >= samples_s[0] - ROUNDING_S) & (time_s <= samples_s[-1] + ROUNDING_S)
    return np.where(inside & (gap_s <= MAX_GAP_S + ROUNDING_S), np.interp(time_s, samples_s, samples), np.nan)


def read_motion(path: Path, offset_s: float = 0.0) -> MotionLog:
    """Read a CSV file with the columns time_s, speed_mps and yaw_rate_radps; `offset_s` is added to its times.

    Raises InputError if a column is missing, values are implausible, or times do not increase or are not in seconds.
    """
    columns = read_columns(path, ("time_s", "speed_mps", "yaw_rate_radps"), (), _MOTION)
    time_s, speed_mps, yaw_rate_radps = columns.values()
    check_times(time_s, path)
    check_limit("speed_mps", speed_mps, LIMITS["vf"], path)
    check_limit("yaw_rate_radps", yaw_rate_radps, LIMITS["wu"], path)
    return MotionLog(time_s + offset_s, speed_mps, yaw_rate_radps)


def read_wheel(path: Path, steering_ratio: float, offset_s: float = 0.0) -> WheelLog:
    """Read a CSV file with wheel_rad, left positive, and time_s or frame, and divide by the steering ratio.

    With both, time_s counts. `offset_s` is added to it. Raises InputError as :func:`read_motion` does.
    """
    columns = read_columns(path, ("wheel_rad",), ("frame", "time_s"), _WHEEL)
    steering_rad, frame, time_s = columns["wheel_rad"] / steering_ratio, columns.get("frame"), columns.get("time_s")
    check_angles(steering_rad, path)
    if time_s is not None:
        check_times(time_s, path)
        return WheelLog(path, steering_rad, time_s + offset_s, None)
    if frame is None:
        raise InputError("has neither time_s nor frame", path, _WHEEL)
    check_frames(frame, path)
    return WheelLog(path, steering_rad, None, frame.astype(np.int64))
