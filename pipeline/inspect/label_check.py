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
_MIN_SPEED_MPS, _WHEELBASE_M = 1.0, 2.7  # as params.yaml has them; here they only tell driving from standing


def impossible(rows: np.ndarray) -> list[str]:
    """Return what no car does in packets [F,30], a clause each: they are damaged, or of something else."""
    speed, _, yaw_rate = _motion(rows)
    counts = {
        f"turns at up to {_most(yaw_rate):.3g} rad/s": _count(yaw_rate, MOST_YAW_RATE_RADPS),
        f"bends with up to {_most(yaw_rate * speed):.3g} m/s² to the side": _count(
            yaw_rate * speed, MOST_SIDEWAYS_MPS2
        ),
        f"drives at up to {_most(speed):.3g} m/s": _count(speed, MOST_SPEED_MPS),
    }
    return [f"{why} in {count} of {len(rows)} frames, which no car does" for why, count in counts.items() if count]


def implausible(rows: np.ndarray, time_s: np.ndarray | None) -> list[str]:
    """Return why labels made of packets [F,30] at times [F] deserve a look, a clause each; none if they do not."""
    speed, sideways, yaw_rate = _motion(rows)
    valid = np.abs(speed) >= _MIN_SPEED_MPS
    steering = label.steering_angle(yaw_rate, speed, _WHEELBASE_M)
    told = label.plausibility(steering, valid, speed, sideways, np.arange(len(rows)) if time_s is None else time_s)
    counts = {
        f"moves sideways at up to {_most(sideways):.3g} m/s: its heading is wrong, better leave it out": "sideways",
        f"drives backwards at up to {-speed.min(initial=0):.3g} m/s": "reversing",
    }
    frames = {why: told[f"{kind}_frames"] for why, kind in counts.items()}
    said = [f"{why} ({count} of {len(rows)} frames)" for why, count in frames.items() if count]
    if time_s is not None and (told["dt_max_s"] or 0) > MOST_STEP_S:
        said.append(f"its time jumps by {told['dt_max_s']:.1f} s")
    if len(rows) and not valid.any():
        said.append("stands still all the time: it has no valid label")
    return said


def _motion(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return speeds forward and to the left, and the yaw rate; what is larger is as impossible, and would overflow."""
    speed, sideways, yaw_rate = (np.clip(rows[:, column], -1e9, 1e9) for column in (VF, VL, WU))
    return speed, sideways, yaw_rate


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
