"""Errors of the labels from one source against those of another: speed, yaw rate and steering angle."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from pipeline.labels.label import Labels


def errors(measured: Labels, true: Labels) -> np.ndarray:
    """Return errors of the labels from one source against those of another, for the same frames, for :func:`score`.

    [5,F]: measured, 0 or 1; then, NaN where not compared, the error of the yaw rate in rad/s, measured / true speed,
    the error of the angle in rad, and the true angle. An angle that is not measured repeats the last one.
    """
    both, started = measured.valid & true.valid, np.maximum.accumulate(measured.valid)
    last = np.maximum.accumulate(np.where(measured.valid, np.arange(len(started)), 0))
    yaw_radps = np.where(both, measured.yaw_rate_radps - true.yaw_rate_radps, np.nan)
    ratio = np.divide(measured.speed_mps, true.speed_mps, out=np.full(len(both), np.nan), where=both)
    true_rad = np.where(true.valid & started, true.steering_rad, np.nan)
    return np.stack([measured.valid, yaw_radps, ratio, measured.steering_rad[last] - true_rad, true_rad])


def score(drives: Sequence[np.ndarray]) -> dict[str, Any] | None:
    """Return the scores over all frames of `drives`, each of :func:`errors`; None without frames. Undefined: None.

    ``valid``: share of valid labels; ``judged``: frames in nmse; ``speed_ratio``: median of measured / true speed;
    ``nmse``: MSE of the last measured steering angle / MSE of predicting zero.
    """
    measured, *compared = np.concatenate([np.zeros((5, 0)), *drives], axis=1)
    if not len(measured):
        return None
    yaw_radps, ratio, error_rad, true_rad = (values[np.isfinite(values)] for values in compared)
    yaw_degps, zero = np.degrees(yaw_radps), float((true_rad**2).sum())
    return {
        "drives": sum(drive.size > 0 for drive in drives),
        "frames": len(measured),
        "valid": float(measured.mean()),
        "judged": len(true_rad),
        "yaw_rmse_degps": float(np.sqrt((yaw_degps**2).mean())) if len(yaw_degps) else None,
        "yaw_median_degps": float(np.median(np.abs(yaw_degps))) if len(yaw_degps) else None,
        "speed_ratio": float(np.median(ratio)) if len(ratio) else None,
        "nmse": float((error_rad**2).sum() / zero) if zero else None,
    }
