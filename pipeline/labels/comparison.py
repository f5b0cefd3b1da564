"""Errors of the labels from one source against those of another: speed, yaw rate and steering angle."""

from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np

from pipeline.labels.label import Labels

INVERTED = -0.5  # largest correlation with the driven angle that means an inverted sign


class Errors(NamedTuple):
    """Errors of the frames of one drive, for :func:`score`."""

    measured: np.ndarray  # bool [F], frames with a valid label
    yaw_radps: np.ndarray  # [M] measured minus true, in frames that are valid in both; NaN where unknown
    speed_ratio: np.ndarray  # [M] measured / true, in the same frames; NaN where unknown
    angle_rad: np.ndarray  # [V] last measured minus true angle, where that is valid, from the first measured frame on
    true_rad: np.ndarray  # [V]


def errors(measured: Labels, true: Labels) -> Errors:
    """Return the errors of the labels from one source against those of another, for the same frames."""
    both, started = measured.valid & true.valid, np.maximum.accumulate(measured.valid)
    last = np.maximum.accumulate(np.where(measured.valid, np.arange(len(started)), 0))
    scored = true.valid & started
    return Errors(
        measured.valid,
        (measured.yaw_rate_radps - true.yaw_rate_radps)[both],
        measured.speed_mps[both] / true.speed_mps[both],
        (measured.steering_rad[last] - true.steering_rad)[scored],
        true.steering_rad[scored],
    )


def score(drives: Iterable[Errors]) -> dict[str, Any] | None:
    """Return the scores over all frames of `drives`; None without frames. Undefined values are None.

    ``valid``: share of valid labels; ``judged``: frames in nmse; ``speed_ratio``: median of measured / true speed;
    ``nmse``: MSE of the last measured steering angle / that of predicting zero; ``correlation``: about zero.
    """
    parts = list(drives)
    joined = Errors(*(np.concatenate(arrays) for arrays in zip(*parts, strict=True))) if parts else None
    if joined is None or not len(joined.measured):
        return None
    yaw_degps, ratio = (values[np.isfinite(values)] for values in (np.degrees(joined.yaw_radps), joined.speed_ratio))
    zero, found = float((joined.true_rad**2).sum()), joined.angle_rad + joined.true_rad
    norm = float(np.sqrt(zero * (found**2).sum()))
    return {
        "drives": sum(len(one.measured) > 0 for one in parts),
        "frames": len(joined.measured),
        "valid": float(joined.measured.mean()),
        "judged": len(joined.true_rad),
        "yaw_rmse_degps": float(np.sqrt((yaw_degps**2).mean())) if len(yaw_degps) else None,
        "yaw_median_degps": float(np.median(np.abs(yaw_degps))) if len(yaw_degps) else None,
        "speed_ratio": float(np.median(ratio)) if len(ratio) else None,
        "nmse": float((joined.angle_rad**2).sum() / zero) if zero else None,
        "correlation": float((found * joined.true_rad).sum() / norm) if norm else None,
    }


def summary_line(figures: dict[str, Any] | None, wheel: bool = False) -> str:
    """Return a line for the log about the result of :func:`score`; `wheel`: one of the two sources is recorded."""
    if not figures or not figures["judged"]:
        return "no frame is both measured and recorded above the minimum speed"
    text = "{valid:.0%} of {frames} frames measured".format_map(figures)
    if figures["speed_ratio"] is not None:
        text += ", yaw rate to {yaw_rmse_degps:.2f} deg/s, speed x {speed_ratio:.3f}".format_map(figures)
    if figures["nmse"] is not None:
        text += f", steering nmse {figures['nmse']:.4f}"
    inverted = wheel and (figures["correlation"] or 0.0) < INVERTED
    return f"{text}: the sign of wheel_rad is inverted: left is positive" if inverted else text
