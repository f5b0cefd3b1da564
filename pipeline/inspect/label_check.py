"""Which labels of a raw drive are implausible, and why: before anything is ingested."""

from typing import Any

import numpy as np

from pipeline import label
from pipeline.kitti.oxts import VF, VL, WU

# A car on its tightest circle (5 m) reaches 1.4 rad/s at 7 m/s, and tyres hold some 10 m/s² to the side. The most in
# 55 drives of KITTI: 0.8 rad/s, 4.9 m/s².
MOST_YAW_RATE_RADPS = 1.5
MOST_SIDEWAYS_MPS2 = 10.0
MOST_SPEED_MPS = 60.0
MOST_STEP_S = 1.0  # between frames at 10 Hz


def implausible(rows: np.ndarray, time_s: np.ndarray | None) -> list[str]:
    """Return why labels made of packets [F,30] at times [F] are not to be trusted, a clause each; none if they are."""
    speed, sideways, yaw_rate = rows[:, VF], rows[:, VL], rows[:, WU]
    valid = np.abs(speed) >= 1.0
    steering = label.steering_angle(yaw_rate, speed, 2.7)
    told = label.plausibility(steering, valid, speed, sideways, np.arange(len(rows)) if time_s is None else time_s)
    counts = {
        f"moves sideways at up to {_most(sideways):.1f} m/s: its heading is wrong": told["sideways_frames"],
        f"drives backwards at up to {-speed.min(initial=0):.1f} m/s": told["reversing_frames"],
        f"turns at up to {_most(yaw_rate):.1f} rad/s, which no car does": _count(yaw_rate, MOST_YAW_RATE_RADPS),
        f"bends with up to {_most(yaw_rate * speed):.0f} m/s² to the side, which no tyre holds": _count(
            yaw_rate * speed, MOST_SIDEWAYS_MPS2
        ),
        f"drives at up to {_most(speed):.0f} m/s": _count(speed, MOST_SPEED_MPS),
    }
    said = [f"{why} ({count} of {len(rows)} frames)" for why, count in counts.items() if count]
    if time_s is not None and (told["dt_max_s"] or 0) > MOST_STEP_S:
        said.append(f"its time jumps by {told['dt_max_s']:.1f} s")
    if len(rows) and not valid.any():
        said.append("stands still all the time: it has no valid label")
    return said


def _most(values: np.ndarray) -> float:
    return float(np.abs(values).max(initial=0))


def _count(values: np.ndarray, limit: float) -> int:
    return int((np.abs(values) > limit).sum())


def summary(rows: np.ndarray) -> dict[str, Any]:
    """Return the least and most of what labels are made of: m/s, rad/s."""
    if not len(rows):
        return {}
    return {
        "speed_mps": [float(rows[:, VF].min()), float(rows[:, VF].max())],
        "yaw_rate_radps": [float(rows[:, WU].min()), float(rows[:, WU].max())],
    }
