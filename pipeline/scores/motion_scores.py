"""Score measured motion against recorded motion."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from pipeline.base.metrics import nmse
from pipeline.ingest.ingest_file import open_ingest
from pipeline.labels import source
from pipeline.labels.label import Car, hold_valid, steering_labels
from pipeline.labels.label_file import Labels
from pipeline.motion.motion_file import open_motion


class MotionErrors(NamedTuple):
    """Errors of measured labels against true labels, in frames [F].

    All but `measured` are NaN in frames in which they are not compared.
    """

    measured: np.ndarray  # bool, whether the measured label is valid
    yaw_rate_radps: np.ndarray  # error of the measured yaw rate
    speed_ratio: np.ndarray  # ratio of measured to true speed
    angle_rad: np.ndarray  # error of the last measured angle
    true_angle_rad: np.ndarray


def score_motion(
    drives: Sequence[str], ingest: Path, motion: Path, car: Car
) -> dict[str, Any] | None:
    """Return the scores of the measured motion, as models get it, against recorded motion.

    The result is None if no drive recorded any. `ingest` and `motion` are the folders of these
    stages.
    """
    errors = []
    for drive in drives:
        errors_of_drive = _compare_drive(ingest / f"{drive}.h5", motion / f"{drive}.h5", car)
        if errors_of_drive:
            errors.append(errors_of_drive)
    return summarise_errors(errors)


def _compare_drive(ingest: Path, motion: Path, car: Car) -> MotionErrors | None:
    """Return the errors in the frames of a file of stage motion; None without recorded motion."""
    with (
        open_ingest(ingest) as raw,
        open_motion(motion) as file,
    ):
        recorded_rates = source.recorded_rates(raw)
        if recorded_rates is None:
            return None
        measured_rates = source.rates_of_motion(raw, motion, smooth=False)
        rows = np.searchsorted(raw.frame, file.frame)
    measured = steering_labels(measured_rates.yaw_rate_radps, measured_rates.speed_mps, car)
    true = steering_labels(recorded_rates.yaw_rate_radps, recorded_rates.speed_mps, car)
    return compare_labels(measured.select_rows(rows), true.select_rows(rows))


def compare_labels(measured: Labels, true: Labels) -> MotionErrors:
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
        measured=measured.valid,
        yaw_rate_radps=np.where(compared, yaw_rate_radps, np.nan),
        speed_ratio=speed_ratio,
        angle_rad=angle_rad - true_rad,
        true_angle_rad=true_rad,
    )


def summarise_errors(drives: Sequence[MotionErrors]) -> dict[str, Any] | None:
    """Return the scores over all frames of `drives`, or None without frames.

    ``valid`` is the share of valid measured labels. ``judged`` is the number of frames in the nmse.
    ``speed_ratio`` is the median ratio of measured to true speed. ``nmse`` is that of the last
    measured steering angle. A score that is not defined is None.
    """
    drives = [drive for drive in drives if len(drive.measured)]
    if not drives:
        return None
    errors = MotionErrors(*[np.concatenate(column) for column in zip(*drives, strict=True)])
    yaw_degps = np.degrees(_drop_nan(errors.yaw_rate_radps))
    true_rad = _drop_nan(errors.true_angle_rad)
    return {
        "drives": len(drives),
        "frames": len(errors.measured),
        "valid": float(errors.measured.mean()),
        "judged": len(true_rad),
        "yaw_rmse_degps": float(np.sqrt((yaw_degps**2).mean())) if len(yaw_degps) else None,
        "yaw_median_degps": _median_or_none(np.abs(yaw_degps)),
        "speed_ratio": _median_or_none(_drop_nan(errors.speed_ratio)),
        "nmse": nmse(true_rad, true_rad + _drop_nan(errors.angle_rad)),
    }


def _drop_nan(values: np.ndarray) -> np.ndarray:
    return values[np.isfinite(values)]


def _median_or_none(values: np.ndarray) -> float | None:
    return float(np.median(values)) if len(values) else None
