"""The car's motion since the previous frame, frame by frame, from images and depth or from scans, and its file."""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from pipeline.base.store import DriveWriter
from pipeline.camera.camera import Camera
from pipeline.camera.frame import Frame
from pipeline.motion import lidar, visual
from pipeline.motion.step import Step, StepClock, rates

RESIDUAL_UNITS = {"visual": "px", "lidar": "m"}


class Estimate(NamedTuple):
    """Measured motion: mean rates over the step, left and forward positive."""

    step: Step
    yaw_rate_radps: float
    speed_mps: float


class MotionEstimator:
    """Measures the motion of one drive; kind: visual or lidar."""

    def __init__(self, kind: str, camera: Camera, *, road_scale: bool) -> None:
        """`road_scale`: correct the scale of depth by the camera's height over the road; visual only."""
        self.odometry: visual.Odometry | lidar.Odometry
        if kind == "visual":
            self.odometry = visual.Odometry(camera.K, camera.size, camera.height_m if road_scale else None)
        else:
            self.odometry = lidar.Odometry(np.eye(4) if camera.T_cam_velo is None else camera.T_cam_velo)
        self._clock = StepClock()

    def estimate(self, frame: Frame) -> Estimate | None:
        """Return the motion since the previous frame; None where it cannot be measured.

        Frames come in order of their numbers. A frame without a scan does not count for lidar.
        """
        if isinstance(self.odometry, lidar.Odometry) and frame.scan is None:
            return None
        step = self.odometry.step(frame)
        duration_s = self._clock.duration(frame.number, frame.time_s)
        return Estimate(step, *rates(step.T_before, duration_s)) if step else None


def write(
    file: DriveWriter, kind: str, frame: np.ndarray, time_s: np.ndarray, estimates: Iterable[Estimate | None]
) -> int:
    """Write data/motion/<kind>/<drive>.h5: each frame's motion since the previous frame, 0 and not valid for None.

    Return the number of valid frames.

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
