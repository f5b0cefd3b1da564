"""Write the motion file of a drive, data/motion/<kind>/<drive>.h5."""

from collections.abc import Iterable

import numpy as np

from pipeline.base.store import DriveWriter
from pipeline.motion.estimator import Estimate

RESIDUAL_UNITS = {"visual": "px", "lidar": "m"}


def write(
    file: DriveWriter, kind: str, frame: np.ndarray, time_s: np.ndarray, estimates: Iterable[Estimate | None]
) -> int:
    """Write each frame's motion since the previous frame; 0 and not valid for None. Return the number of valid frames.

    Args:
        frame: KITTI frame numbers [F].
        time_s: their times [F].
        estimates: one for each frame.
    """
    frame = np.asarray(frame, np.int32)
    count = len(frame)
    yaw_rate_radps, speed_mps, residual = np.zeros((3, count), np.float32)
    inliers, valid = np.zeros(count, np.int32), np.zeros(count, np.uint8)
    T_before, scale = np.tile(np.eye(4, dtype=np.float32), (count, 1, 1)), np.ones(count, np.float32)
    for row, estimate in enumerate(estimates):
        if estimate is not None:
            valid[row] = 1
            step, yaw_rate_radps[row], speed_mps[row] = estimate
            T_before[row], inliers[row], residual[row], scale[row] = step
    file.put("frame", frame)
    file.put("time_s", time_s, "s")
    file.put("yaw_rate_radps", yaw_rate_radps, "rad/s, left positive")
    file.put("speed_mps", speed_mps, "m/s, forward positive")
    file.put("inliers", inliers)
    file.put("residual", residual, RESIDUAL_UNITS[kind])
    file.put("valid", valid)
    file.put("T_before", T_before, "m")
    if kind == "visual":
        file.put("scale", scale, "depth was multiplied by it")
    return int(valid.sum())
