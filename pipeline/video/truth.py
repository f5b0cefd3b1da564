"""What was driven: from oxts or steering.csv of a KITTI drive, or from logs."""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from pipeline.base.store import DriveReader
from pipeline.labels import sources
from pipeline.labels.label import Car, steering_labels
from pipeline.video.log import MotionLog, WheelLog, check_ratio, read_motion, read_wheel

MAX_GAP_S = 2.0  # between samples of a log that are interpolated, as by steer import


class Logs(NamedTuple):
    """A log of the front wheels' angles, one of the car's motion, and the names of their files."""

    wheel: WheelLog | None = None
    motion: MotionLog | None = None
    name: str = ""

    @classmethod
    def read(cls, wheel: Path | None, steering_ratio: float | None, motion: Path | None) -> "Logs":
        """Read a log of the steering wheel's angles, its ratio to the front wheels', and a log of the motion.

        Raises InputError for unusable logs.
        """
        check_ratio(wheel, steering_ratio)
        name = " and ".join(path.name for path in (wheel, motion) if path)
        angles = read_wheel(wheel, steering_ratio) if wheel and steering_ratio else None
        return cls(angles, read_motion(motion) if motion else None, name)


class Truth(NamedTuple):
    """Driven angles and speeds of F frames, NaN where unknown, where they are from, and the column of the angles."""

    name: str  # empty: unknown
    column: str
    driven_rad: np.ndarray  # [F] of the front wheels, left positive
    driven_mps: np.ndarray  # [F]


def read_truth(ingest: DriveReader, frame: np.ndarray, logs: Logs, car: Car) -> Truth:
    """Return the truth for frame numbers [F] of an ingest file; logs, if there are any, replace what the file has.

    With both logs, the angle is the wheel's.
    """
    rows, unknown = np.searchsorted(ingest.frame, frame), np.full(len(frame), np.nan)
    recorded, time_s = sources.recorded(ingest), ingest.time_s[rows]
    if not logs.name and recorded:
        labels = sources.read(recorded[0], ingest, None, car).at(rows)
        name, column = {"oxts": ("oxts", "wu"), "wheel": ("steering.csv", "steering_rad")}[recorded[0]]
        return Truth(name, column, np.where(labels.valid, labels.steering_rad, np.nan), labels.speed_mps)
    column, driven_rad, driven_mps = "yaw_rate_radps", unknown, unknown
    if logs.motion:
        driven_mps, yaw_rate_radps = logs.motion.at(time_s, MAX_GAP_S)
        angles, valid = steering_labels(yaw_rate_radps, driven_mps, **vars(car))
        driven_rad = np.where(valid, angles, np.nan)
    if logs.wheel:
        column, driven_rad = "wheel_rad", logs.wheel.at(frame, time_s, MAX_GAP_S)
    return Truth(logs.name, column, driven_rad, driven_mps)
