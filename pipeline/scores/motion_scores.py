"""Errors of measured motion, and of steering angles, against what the drives recorded."""

from collections.abc import Sequence
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.base.metrics import nmse
from pipeline.base.store import DriveReader
from pipeline.labels import source
from pipeline.labels.label import Car, Labels, held


def score_motion(drives: list[str], ingest: Path, motion: Path, car: Car) -> dict[str, Any]:
    """Return scores, against recorded motion, of the motion that models get (visual) and of
    steering angles (wheel).

    ``visual-wheel``: against steering angles. Only what the `drives` recorded is compared, possibly
    nothing.
    """
    errors: dict[str, list[np.ndarray]] = {}
    for drive in drives:
        with DriveReader(ingest / f"{drive}.h5", stage="ingest") as raw:
            references, measured = source.recorded(raw, car), motion / f"{drive}.h5"
            kinds = ("visual", *references)
            labels = {
                kind: source.read(kind, raw, measured, car, look_ahead=False) for kind in kinds
            }
            with DriveReader(measured, stage="motion") as file:
                rows = {"visual": np.searchsorted(raw.frame, file.frame)}
            if "wheel" in references:
                rows["wheel"], unknown = (
                    np.flatnonzero(raw["has_steering"]),
                    np.full(len(raw.frame), np.nan),
                )
                # A wheel records no speed: these labels have the speed of another source.
                labels["wheel"] = labels["wheel"]._replace(
                    speed_mps=unknown, yaw_rate_radps=unknown
                )
        for reference, kind in product(references, rows):
            if kind != reference:
                name = kind if reference == "recorded" else f"{kind}-{reference}"
                pair = labels[kind].at(rows[kind]), labels[reference].at(rows[kind])
                errors.setdefault(name, []).append(label_errors(*pair))
    return {kind: score(errors_of_kind) for kind, errors_of_kind in errors.items()}


def label_errors(measured: Labels, true: Labels) -> np.ndarray:
    """Return errors of the labels from one source against those of another, for the same frames,
    for :func:`score`.

    [5,F]: measured, 0 or 1; then, NaN where not compared, the error of the yaw rate in rad/s,
    measured / true speed, the error of the angle in rad, and the true angle. An angle that is not
    measured repeats the last one.
    """
    both, held_rad = (
        measured.valid & true.valid,
        held(measured.steering_rad, measured.valid, initial=np.nan),
    )
    yaw_radps = np.where(both, measured.yaw_rate_radps - true.yaw_rate_radps, np.nan)
    ratio = np.divide(
        measured.speed_mps, true.speed_mps, out=np.full(len(both), np.nan), where=both
    )
    true_rad = np.where(true.valid & np.isfinite(held_rad), true.steering_rad, np.nan)
    return np.stack([measured.valid, yaw_radps, ratio, held_rad - true_rad, true_rad])


def score(drives: Sequence[np.ndarray]) -> dict[str, Any] | None:
    """Return the scores over all frames of `drives`, each of :func:`errors`; None without frames.
    Undefined: None.

    ``valid``: share of valid labels; ``judged``: frames in nmse; ``speed_ratio``: median of
    measured / true speed; ``nmse``: of the last measured steering angle.
    """
    measured, *compared = np.concatenate([np.zeros((5, 0)), *drives], axis=1)
    if not len(measured):
        return None
    yaw_radps, ratio, error_rad, true_rad = (values[np.isfinite(values)] for values in compared)
    yaw_degps = np.degrees(yaw_radps)
    return {
        "drives": sum(drive.size > 0 for drive in drives),
        "frames": len(measured),
        "valid": float(measured.mean()),
        "judged": len(true_rad),
        "yaw_rmse_degps": float(np.sqrt((yaw_degps**2).mean())) if len(yaw_degps) else None,
        "yaw_median_degps": float(np.median(np.abs(yaw_degps))) if len(yaw_degps) else None,
        "speed_ratio": float(np.median(ratio)) if len(ratio) else None,
        "nmse": nmse(true_rad, true_rad + error_rad),
    }
