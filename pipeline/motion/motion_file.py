"""The writer of a motion file, data/motion/<kind>/<drive>.h5: each frame's motion since the frame before."""

from collections.abc import Iterable

import numpy as np

from pipeline.base.store import DriveWriter
from pipeline.motion.step import Step, durations, rates

UNITS = {"visual": "px", "lidar": "m"}  # of the residual, by kind


def write(file: DriveWriter, kind: str, frame: np.ndarray, time_s: np.ndarray, steps: Iterable[Step | None]) -> int:
    """Write each frame's step since the frame before; None: not measured, all 0. Return how many are measured.

    Args:
        frame: KITTI frame numbers [F]; time_s: their times [F].
        steps: one for each frame.
    """
    dt_s = durations(frame, time_s)
    frame = np.asarray(frame, np.int32)
    count = len(frame)
    yaw_rate_radps, speed_mps, residual = np.zeros((3, count), np.float32)
    inliers, valid = np.zeros(count, np.int32), np.zeros(count, np.uint8)
    T_before, scale = np.tile(np.eye(4, dtype=np.float32), (count, 1, 1)), np.ones(count, np.float32)
    for row, step in enumerate(steps):
        if step is not None:
            yaw_rate_radps[row], speed_mps[row] = rates(step.T_before, dt_s[row])
            valid[row] = 1
            T_before[row], inliers[row], residual[row], scale[row] = step
    file.put("frame", frame)
    file.put("time_s", time_s, "s")
    file.put("yaw_rate_radps", yaw_rate_radps, "rad/s, left positive")
    file.put("speed_mps", speed_mps, "m/s, forward positive")
    file.put("inliers", inliers)
    file.put("residual", residual, UNITS[kind])
    file.put("valid", valid)
    file.put("T_before", T_before, "m")
    if kind == "visual":
        file.put("scale", scale, "depth was multiplied by it")
    return int(valid.sum())
