"""Make and write a drive's labels from the folder that has its speed and yaw rate.

A drive's speed and yaw rate are recorded ones in its file of stage ingest, by oxts or a log, or
those that stage motion measures in images. Its angle follows from them by the bicycle model, or is
the recorded angle in its file of stage ingest.
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from pipeline.base.errors import InputError
from pipeline.base.store import DriveReader, DriveWriter
from pipeline.base.summary import Summary
from pipeline.ingest.ingest_file import open_ingest
from pipeline.labels.ahead import path_ahead
from pipeline.labels.label import Car, steering_labels
from pipeline.labels.label_file import UNITS, Labels, create_labels
from pipeline.labels.settings import Labels as Settings
from pipeline.motion.motion_file import is_standing, open_motion, read_rates


class Rates(NamedTuple):
    """The motion in the frames [F] of an ingest file, NaN where it is unknown."""

    speed_mps: np.ndarray  # forward positive
    yaw_rate_radps: np.ndarray  # left positive
    stands: np.ndarray  # bool, whether the motion is not measured because nothing moves


def labels_drive(
    path: Path, ingest: Path, motion: Path | None = None, *, settings: Settings
) -> Summary:
    """Write data/labels/<drive>.h5, and return counts of frames for the summary.

    `ingest` and `motion` are the drive's files of these stages. `motion` is read if it is the
    source. Raises InputError if the drive lacks the source or a recorded angle.
    """
    car = Car(settings.wheelbase_m, settings.min_speed_mps)
    with open_ingest(ingest) as raw:
        rates = recorded_rates(raw) if motion is None else rates_of_motion(raw, motion)
        if rates is None:
            problem = "drive has no recorded speed and yaw rate"
            raise InputError(problem, raw.path, "Set labels.source: motion")
        labels: Labels | None = steering_labels(rates.yaw_rate_radps, rates.speed_mps, car)
        if settings.angle == "recorded":
            labels = recorded_angles(raw, rates, car)
        if labels is None:
            needed = "steering.csv of a drive in KITTI's layout, or a log of the steering wheel"
            problem = f"drive has no recorded angles ({needed})"
            raise InputError(problem, raw.path, "Set labels.angle: computed")

    params = {"labels": settings.model_dump()}
    with create_labels(path, drive=raw.drive, params=params) as file:
        file.attrs["measured"] = int(settings.are_measured)
        write_labels(file, raw.frame, raw.time_s, labels, settings)
    return {"frames": len(raw.frame), "valid": int(labels.valid.sum())}


def write_labels(
    file: DriveWriter, frame: np.ndarray, time_s: np.ndarray, labels: Labels, settings: Settings
) -> None:
    """Write the labels of frames [F], and their path ahead if the settings have `ahead_m`.

    Unknown speeds and yaw rates are written as NaN. As 0, they would be the truth of a quantity
    that reads them where labels are valid.
    """
    columns = {
        "frame": np.asarray(frame, np.int32),
        "time_s": time_s,
        "steering_rad": labels.steering_rad,
        "valid": labels.valid.astype(np.uint8),
        "speed_mps": labels.speed_mps,
        "yaw_rate_radps": labels.yaw_rate_radps,
        "curvature_1pm": np.tan(labels.steering_rad) / settings.wheelbase_m,
    }
    if settings.ahead_m:
        ahead_1pm, valid = path_ahead(frame, time_s, labels, settings.ahead_m, settings.max_stand_s)
        columns["ahead_1pm"] = ahead_1pm
        columns["ahead_valid"] = valid.astype(np.uint8)
    for name, values in columns.items():
        file.put(name, values, UNITS[name])


def recorded_rates(raw: DriveReader) -> Rates | None:
    """Return the recorded motion, or None if the drive has none.

    It is unknown in frames whose packet KITTI interpolated, since that is no measurement.
    """
    if "speed_mps" not in raw:
        return None
    return Rates(raw["speed_mps"], raw["yaw_rate_radps"], np.zeros(len(raw.frame), bool))


def rates_of_motion(raw: DriveReader, path: Path, *, smooth: bool = True) -> Rates:
    """Return the motion that stage motion measured, NaN in frames without a measurement.

    `path` is the drive's file of stage motion. Smooth rates depend on later frames, so no model may
    get them as inputs. The others are the causal rates that models get.
    """
    speed_mps = np.full(len(raw.frame), np.nan)
    yaw_rate_radps = np.full(len(raw.frame), np.nan)
    standing = np.zeros(len(raw.frame), bool)
    with open_motion(path) as motion:
        rows = np.searchsorted(raw.frame, motion.frame)
        rates = read_rates(motion, smooth=smooth)
        speed_mps[rows] = rates.speed_mps
        yaw_rate_radps[rows] = rates.yaw_rate_radps
        standing[rows] = is_standing(motion)
    return Rates(speed_mps, yaw_rate_radps, standing)


def recorded_angles(raw: DriveReader, rates: Rates | None, car: Car) -> Labels | None:
    """Return labels with the recorded angles of the front wheels, or None if the drive has none.

    A label is valid if the frame has a recorded angle and the car moves by its `rates`. If the
    speed of a frame is unknown, the car is taken to move, unless its motion was not measured
    because nothing moves. The yaw rate is computed from the recorded angle by the bicycle model, so
    that the path ahead follows from recorded angles and not from measured turns.
    """
    if "steering_rad" not in raw:
        return None
    if rates is None:
        unknown = np.full(len(raw.frame), np.nan)
        rates = Rates(unknown, unknown, np.zeros(len(raw.frame), bool))
    speed_mps = rates.speed_mps
    moves = np.where(np.isfinite(speed_mps), np.abs(speed_mps) >= car.min_speed_mps, ~rates.stands)

    has_angle = raw["has_steering"].astype(bool)
    steering_rad = raw["steering_rad"]
    yaw_rate_radps = speed_mps * np.tan(steering_rad) / car.wheelbase_m
    yaw_rate_radps = np.where(has_angle, yaw_rate_radps, np.nan)
    return Labels(
        steering_rad=steering_rad,
        valid=has_angle & moves,
        speed_mps=speed_mps,
        yaw_rate_radps=yaw_rate_radps,
    )
