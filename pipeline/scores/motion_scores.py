"""Score measured motion, and steering angles, against what the drives recorded."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from pipeline.base.metrics import nmse
from pipeline.base.store import DriveReader
from pipeline.labels import source
from pipeline.labels.label import Car, Labels, hold_valid


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
        # Names of the recorded sources that the drive has.
        references = [*source.recorded_labels(raw, car)]
        labels = {}
        for kind in ("visual", *references):
            labels[kind] = source.make_labels(kind, raw, motion, car, look_ahead=False)
        with DriveReader(motion, stage="motion") as file:
            rows = {"visual": np.searchsorted(raw.frame, file.frame)}
        if "wheel" in references:
            rows["wheel"] = np.flatnonzero(raw["has_steering"])
            # A wheel records no speed, so these labels have the speed of another source, which must
            # not be scored.
            unknown = np.full(len(raw.frame), np.nan)
            labels["wheel"] = labels["wheel"]._replace(speed_mps=unknown, yaw_rate_radps=unknown)

    errors = {}
    for reference in references:
        for kind, frames in rows.items():
            if kind != reference:
                name = kind if reference == "recorded" else f"{kind}-{reference}"
                errors[name] = label_errors(labels[kind].at(frames), labels[reference].at(frames))
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
