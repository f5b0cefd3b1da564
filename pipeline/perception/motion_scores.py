"""The score card of measured motion against oxts: what it is worth as a speedometer, and as a measure of steering."""

from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np

from pipeline.label import measured_angle, steering_angle


class Errors(NamedTuple):
    """Of a drive's frames, one after the other; :func:`card` takes those of many drives together."""

    measured: np.ndarray  # bool [F]: is there a measurement?
    yaw_radps: np.ndarray  # [M] measured minus true, of the measured frames that are not too slow
    speed_ratio: np.ndarray  # [M] measured over true, of the same
    held_rad: np.ndarray  # [V] measured angle, held, minus the true one, not too slow, from the first measured on
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
    """Return the errors of a drive's measured motion, all arrays [F] of the same frames; the true ones are oxts'.

    `wheelbase_m` and `min_speed_mps`, below which an angle is noise, are those of the labels.
    """
    measured = np.asarray(valid, bool)
    moving = np.abs(true_speed_mps) >= min_speed_mps
    both, begun = measured & moving, np.maximum.accumulate(measured)
    held = measured_angle(yaw_rate_radps, speed_mps, measured, wheelbase_m, min_speed_mps)
    true = steering_angle(true_yaw_rate_radps, true_speed_mps, wheelbase_m)
    judged = moving & begun
    return Errors(
        measured,
        (yaw_rate_radps - true_yaw_rate_radps)[both],
        speed_mps[both] / true_speed_mps[both],
        (held - true)[judged],
        true[judged],
    )


def card(drives: Iterable[Errors]) -> dict[str, Any] | None:
    """Return the figures of these drives' frames; None without frames. What cannot be told is None.

    ``drives`` that have any; ``frames`` with an image or scan; ``valid``: the share that is measured; ``judged``: the
    frames that nmse is of, none of a drive in which nothing was measured; ``yaw_rmse_degps``, ``yaw_median_degps``;
    ``speed_ratio``: the median of measured over true speed; ``nmse`` of the steering angle that the last measurement
    says, over that of always straight on.
    """
    parts = list(drives)
    all_of = Errors(*(np.concatenate(arrays) for arrays in zip(*parts, strict=True))) if parts else None
    if all_of is None or not len(all_of.measured):
        return None
    yaw_degps, known = np.degrees(all_of.yaw_radps), len(all_of.yaw_radps) > 0
    straight = float((all_of.true_rad**2).sum())
    return {
        "drives": sum(len(one.measured) > 0 for one in parts),
        "frames": len(all_of.measured),
        "valid": float(all_of.measured.mean()),
        "judged": len(all_of.true_rad),
        "yaw_rmse_degps": float(np.sqrt((yaw_degps**2).mean())) if known else None,
        "yaw_median_degps": float(np.median(np.abs(yaw_degps))) if known else None,
        "speed_ratio": float(np.median(all_of.speed_ratio)) if known else None,
        "nmse": float((all_of.held_rad**2).sum() / straight) if straight else None,
    }


def summary_line(figures: dict[str, Any] | None) -> str:
    """Return what the log says of a :func:`card`."""
    if not figures or figures["speed_ratio"] is None:
        return "nothing measured that oxts could judge"
    text = (
        "{valid:.0%} of {frames} frames measured, yaw rate to {yaw_rmse_degps:.2f} deg/s, speed x {speed_ratio:.3f}"
    ).format_map(figures)
    return text if figures["nmse"] is None else f"{text}, steering nmse {figures['nmse']:.4f}"
