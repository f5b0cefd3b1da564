"""The angle and the speed that were driven: from oxts or steering.csv of a KITTI drive, or from logs."""

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from pipeline.base.errors import DamagedFile, InputError
from pipeline.kitti import oxts, steering_file
from pipeline.kitti.raw import KittiDrive
from pipeline.labels import label
from pipeline.labels.label import Car
from pipeline.video.log import check_ratio, read_motion, read_wheel

MAX_GAP_S = 2.0  # between samples of a log that are interpolated, as by steer import


class Driven(NamedTuple):
    """Angle of the front wheels, left positive, and speed; None where unknown."""

    driven_rad: float | None = None
    driven_mps: float | None = None


class Truth(NamedTuple):
    """What was driven, and where it is from; an empty name: unknown."""

    name: str
    at: Callable[[int, float], Driven]  # by number and time of a frame


UNKNOWN = Truth("", lambda number, time_s: Driven())


def of_drive(drive: KittiDrive, car: Car, notes: list[str]) -> Truth:
    """Return the truth of a KITTI drive: oxts, or steering.csv without oxts. Damaged files become `notes`."""
    packets, damaged = drive.oxts, set[int]()

    def packet(number: int, _: float) -> Driven:
        if number not in packets:
            return Driven()
        try:
            row = oxts.read_row(packets[number])
        except DamagedFile as error:
            if not damaged:
                notes.append(f"without the driven angle: {error}")
            damaged.add(number)
            return Driven()
        return _by_motion(row[oxts.WU], row[oxts.VF], car)

    if packets:
        return Truth("oxts", packet)
    try:
        recorded = steering_file.read(drive.steering) if drive.steering else {}
    except InputError as error:
        notes.append(f"without the driven angle: {error}")
        recorded = {}
    return Truth(steering_file.FILE, lambda number, _: Driven(recorded.get(number))) if recorded else UNKNOWN


def of_logs(wheel: Path | None, steering_ratio: float | None, motion: Path | None, car: Car) -> Truth | None:
    """Return the truth of a CSV file of wheel angles, a log of speed and yaw rate, or both; None without logs.

    With both, the angle is the wheel's. Raises InputError for unusable logs: see :mod:`pipeline.recording.motion_log`.
    """
    check_ratio(wheel, steering_ratio)
    if not (wheel or motion):
        return None
    angles = read_wheel(wheel, steering_ratio) if wheel and steering_ratio else None
    rates = read_motion(motion) if motion else None

    def at(number: int, time_s: float) -> Driven:
        driven, now = Driven(), np.array([time_s])
        if rates:
            speed_mps, yaw_rate_radps = (float(rate[0]) for rate in rates.at(now, MAX_GAP_S))
            if np.isfinite(speed_mps):
                driven = _by_motion(yaw_rate_radps, speed_mps, car)
        if not angles:
            return driven
        angle = float(angles.at(np.array([number]), now, MAX_GAP_S)[0])
        return driven._replace(driven_rad=angle if np.isfinite(angle) else None)

    return Truth(" and ".join(path.name for path in (wheel, motion) if path), at)


def _by_motion(yaw_rate_radps: float, speed_mps: float, car: Car) -> Driven:
    """Return the label of a speed and a yaw rate; no angle below the car's minimum speed."""
    rates = np.array([yaw_rate_radps]), np.array([speed_mps])
    steering_rad, valid = label.steering_labels(*rates, **vars(car))
    return Driven(float(steering_rad[0]) if valid[0] else None, float(speed_mps))
