"""Score measured motion, and steering angles, against what the drives recorded."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from pipeline.base.metrics import nmse
from pipeline.base.store import DriveReader
from pipeline.labels import source
from pipeline.labels.label import Car, Labels, hold_valid, steering_labels


class MotionErrors(NamedTuple):
    """Errors of measured labels against true labels, in frames [F].

    All but `measured` are NaN in frames in which they are not compared.
    """

    measured: np.ndarray  # bool, whether the measured label is valid
    yaw_rate_radps: np.ndarray  # error of the measured yaw rate
    speed_ratio: np.ndarray  # ratio of measured to true speed
    angle_rad: np.ndarray  # error of the last measured angle
    true_angle_rad: np.ndarray


def score_motion(drives: list[str], ingest: Path, motion: Path, car: Car) -> dict[str, Any]:
    """Return comparison → scores, for measured motion and recorded angles.

    - ``visual`` compares the measured motion, as models get it, with recorded motion.
    - ``wheel`` compares recorded steering angles with recorded motion.
    - ``visual-wheel`` compares the measured motion with recorded steering angles.

    A comparison is missing if no drive recorded its reference. `ingest` and `motion` are the
    folders of these stages.
    """
    errors: dict[str, list[MotionErrors]] = {}
    for drive in drives:
        compared = _compare_drive(ingest / f"{drive}.h5", motion / f"{drive}.h5", car)
        for name, errors_of_drive in compared.items():
            errors.setdefault(name, []).append(errors_of_drive)
    return {name: score(errors_of_drives) for name, errors_of_drives in errors.items()}


def _compare_drive(ingest: Path, motion: Path, car: Car) -> dict[str, MotionErrors]:
    with DriveReader(ingest, stage="ingest") as raw:
        measured_rates = source.rates_of_motion(raw, motion, smooth=False)
        recorded_rates = source.recorded_rates(raw)
        measured = steering_labels(measured_rates.yaw_rate_radps, measured_rates.speed_mps, car)
        wheel = source.recorded_angles(raw, recorded_rates or measured_rates, car)
        with DriveReader(motion, stage="motion") as file:
            measured_rows = np.searchsorted(raw.frame, file.frame)
        wheel_rows = np.zeros(0, int)
        if wheel:
            wheel_rows = np.flatnonzero(raw["has_steering"])
            # A wheel records no speed, so these labels have the speed of another source, which must
            # not be scored.
            unknown = np.full(len(raw.frame), np.nan)
            wheel = wheel._replace(speed_mps=unknown, yaw_rate_radps=unknown)

    errors = {}
    if recorded_rates:
        true = steering_labels(recorded_rates.yaw_rate_radps, recorded_rates.speed_mps, car)
        errors["visual"] = label_errors(measured.at(measured_rows), true.at(measured_rows))
    if wheel:
        errors["visual-wheel"] = label_errors(measured.at(measured_rows), wheel.at(measured_rows))
    if recorded_rates and wheel:
        errors["wheel"] = label_errors(wheel.at(wheel_rows), true.at(wheel_rows))
    return errors


def label_errors(measured: Labels, true: Labels) -> MotionErrors:
    """Return the errors of measured labels against true labels of the same frames [F].

    A frame whose angle is not measured repeats the last measured angle.
    """
    compared = measured.valid & true.valid
    yaw_rate_radps = measured.yaw_rate_radps - true.yaw_rate_radps
    unknown = np.full(len(compared), np.nan)
    speed_ratio = np.divide(measured.speed_mps, true.speed_mps, out=unknown, where=compared)
    angle_rad = hold_valid(measured.steering_rad, measured.valid, initial=np.nan)
    true_rad = np.where(true.valid & np.isfinite(angle_rad), true.steering_rad, np.nan)
    return MotionErrors(
        measured.valid,
        np.where(compared, yaw_rate_radps, np.nan),
        speed_ratio,
        angle_rad - true_rad,
        true_rad,
    )


def score(drives: Sequence[MotionErrors]) -> dict[str, Any] | None:
    """Return the scores over all frames of `drives`, or None without frames.

    ``valid`` is the share of valid measured labels. ``judged`` is the number of frames in the nmse.
    ``speed_ratio`` is the median ratio of measured to true speed. ``nmse`` is that of the last
    measured steering angle. A score that is not defined is None.
    """
    drives = [drive for drive in drives if len(drive.measured)]
    if not drives:
        return None
    errors = MotionErrors(*[np.concatenate(column) for column in zip(*drives, strict=True)])
    yaw_degps = np.degrees(_finite(errors.yaw_rate_radps))
    true_rad = _finite(errors.true_angle_rad)
    return {
        "drives": len(drives),
        "frames": len(errors.measured),
        "valid": float(errors.measured.mean()),
        "judged": len(true_rad),
        "yaw_rmse_degps": float(np.sqrt((yaw_degps**2).mean())) if len(yaw_degps) else None,
        "yaw_median_degps": _median(np.abs(yaw_degps)),
        "speed_ratio": _median(_finite(errors.speed_ratio)),
        "nmse": nmse(true_rad, true_rad + _finite(errors.angle_rad)),
    }


def _finite(values: np.ndarray) -> np.ndarray:
    return values[np.isfinite(values)]


def _median(values: np.ndarray) -> float | None:
    return float(np.median(values)) if len(values) else None
