"""The car's motion since the previous frame, frame by frame, from images and depth or from scans."""

import math
from typing import NamedTuple

import numpy as np

from pipeline.camera.camera import Camera, Frame
from pipeline.motion import lidar, visual
from pipeline.motion.step import Step, StepClock, rates


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
            self.odometry = visual.Odometry(camera, road_scale=road_scale)
        else:
            self.odometry = lidar.Odometry(np.eye(4) if camera.T_cam_velo is None else camera.T_cam_velo)
        self._clock = StepClock()
        self.road_frames = 0
        """Frames so far in which the road was found, which gives depth its scale; visual only."""

    def estimate(self, frame: Frame) -> Estimate | None:
        """Return the motion since the previous frame; None where it cannot be measured.

        Frames come in order of their numbers. A frame without a scan does not count for lidar.
        """
        if isinstance(self.odometry, lidar.Odometry) and frame.scan is None:
            return None
        step = self.odometry.step(frame)
        if isinstance(self.odometry, visual.Odometry):
            self.road_frames += math.isfinite(self.odometry.road.frame_height_m)
        duration_s = self._clock.duration(frame.number, frame.time_s)
        return Estimate(step, *rates(step.T_before, duration_s)) if step else None
