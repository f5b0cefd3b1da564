"""Errors of measured motion against oxts: speed, yaw rate, and the steering angle computed from them."""

from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np

from pipeline.label import measured_angle, steering_angle


class Errors(NamedTuple):
    """Errors of the frames of one drive, for :func:`score`."""

    measured: np.ndarray  # bool [F], frames with valid motion
    yaw_radps: np.ndarray  # [M] measured minus true, in measured frames that are not too slow
    speed_ratio: np.ndarray  # [M] measured / true, in the same frames
    angle_rad: np.ndarray  # [V] last measured minus true angle, not too slow, from the first measured frame on
    true_rad: np.ndarray  # [V]


def errors(
    yaw_rate_radps: np.ndarray,
    speed_mps: np.ndarray,
    valid: np.ndarray,
    true_yaw_rate_radps: np.ndarray,
    true_speed_mps: np.ndarray,
    *,
    wheelbase_m: float,
    min_speed_mps: float,
) -> Errors:
    """Return the errors of the measured motion of a drive; all arrays [F], true values by oxts.

    `wheelbase_m` and `min_speed_mps`, below which an angle is noise, as for the labels.
    """
    measured = np.asarray(valid, bool)
    moving = np.abs(true_speed_mps) >= min_speed_mps
    both, started = measured & moving, np.maximum.accumulate(measured)
    angle = measured_angle(yaw_rate_radps, speed_mps, measured, wheelbase_m, min_speed_mps)
    true = steering_angle(true_yaw_rate_radps, true_speed_mps, wheelbase_m)
    scored = moving & started
    return Errors(
        measured,
        (yaw_rate_radps - true_yaw_rate_radps)[both],
        speed_mps[both] / true_speed_mps[both],
        (angle - true)[scored],
        true[scored],
    )


def score(drives: Iterable[Errors]) -> dict[str, Any] | None:
    """Return the scores over all frames of `drives`; None without frames. Undefined values are None.

    ``drives``: number with frames; ``frames``: with an image or scan; ``valid``: share of measured frames; ``judged``:
    frames in nmse, none for drives without a measurement; ``yaw_rmse_degps``, ``yaw_median_degps``; ``speed_ratio``:
    median of measured / true speed; ``nmse``: MSE of the last measured steering angle / MSE of predicting zero.
    """
    parts = list(drives)
    every = Errors(*(np.concatenate(arrays) for arrays in zip(*parts, strict=True))) if parts else None
    if every is None or not len(every.measured):
        return None
    yaw_degps, known = np.degrees(every.yaw_radps), len(every.yaw_radps) > 0
    zero = float((every.true_rad**2).sum())
    return {
        "drives": sum(len(one.measured) > 0 for one in parts),
        "frames": len(every.measured),
        "valid": float(every.measured.mean()),
        "judged": len(every.true_rad),
        "yaw_rmse_degps": float(np.sqrt((yaw_degps**2).mean())) if known else None,
        "yaw_median_degps": float(np.median(np.abs(yaw_degps))) if known else None,
        "speed_ratio": float(np.median(every.speed_ratio)) if known else None,
        "nmse": float((every.angle_rad**2).sum() / zero) if zero else None,
    }


def summary_line(figures: dict[str, Any] | None) -> str:
    """Return a line for the log about the result of :func:`score`."""
    if not figures or figures["speed_ratio"] is None:
        return "no measured frame with oxts above the minimum speed"
    text = (
        "{valid:.0%} of {frames} frames measured, yaw rate to {yaw_rmse_degps:.2f} deg/s, speed x {speed_ratio:.3f}"
    ).format_map(figures)
    return text if figures["nmse"] is None else f"{text}, steering nmse {figures['nmse']:.4f}"
