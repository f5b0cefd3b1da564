"""What was driven: from oxts or steering.csv of a KITTI drive, or from logs."""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from pipeline.base.store import DriveReader
from pipeline.labels import sources
from pipeline.labels.label import Car, steering_labels
from pipeline.video.log import check_ratio, read_motion, read_wheel

MAX_GAP_S = 2.0  # between samples of a log that are interpolated, as by steer import


class Logs(NamedTuple):
    """A log of the steering wheel's angles with its ratio to the front wheels' angles, and one of the car's motion."""

    wheel: Path | None = None
    steering_ratio: float | None = None
    motion: Path | None = None


class Truth(NamedTuple):
    """Driven angles and speeds of F frames, NaN where unknown, where they are from, and the column of the angles."""

    name: str  # empty: unknown
    column: str
    driven_rad: np.ndarray  # [F] of the front wheels, left positive
    driven_mps: np.ndarray  # [F]


def read_truth(ingest: DriveReader, frame: np.ndarray, logs: Logs, car: Car) -> Truth:
    """Return the truth for frame numbers [F] of an ingest file; logs, if there are any, replace what the file has.

    With both logs, the angle is the wheel's. Raises InputError for unusable logs.
    """
    check_ratio(logs.wheel, logs.steering_ratio)
    rows, unknown = np.searchsorted(ingest.frame, frame), np.full(len(frame), np.nan)
    time_s = ingest.time_s[rows]
    if logs.wheel or logs.motion:
        name = " and ".join(path.name for path in (logs.wheel, logs.motion) if path)
        column, driven_rad, driven_mps = "yaw_rate_radps", unknown, unknown
        if logs.motion:
            driven_mps, yaw_rate_radps = read_motion(logs.motion).at(time_s, MAX_GAP_S)
            angles, valid = steering_labels(yaw_rate_radps, driven_mps, **vars(car))
            driven_rad = np.where(valid, angles, np.nan)
        if logs.wheel and logs.steering_ratio:
            wheel = read_wheel(logs.wheel, logs.steering_ratio)
            wheel.check_frames(int(ingest.frame[-1]))
            column, driven_rad = "wheel_rad", wheel.at(frame, time_s, MAX_GAP_S)
        return Truth(name, column, driven_rad, driven_mps)
    recorded = sources.recorded(ingest)
    if not recorded:
        return Truth("", "", unknown, unknown)
    labels = sources.read(recorded[0], ingest, None, car).at(rows)
    name, column = {"oxts": ("oxts", "wu"), "wheel": ("steering.csv", "steering_rad")}[recorded[0]]
    return Truth(name, column, np.where(labels.valid, labels.steering_rad, np.nan), labels.speed_mps)
