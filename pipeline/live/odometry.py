"""Measured motion of a stream of frames, one after the other: the numbers that stage motion writes of a whole drive."""

from collections import deque

import numpy as np

from pipeline import label
from pipeline.camera.images import to_metres
from pipeline.live.moment import Moment, Motion
from pipeline.motion import lidar, visual
from pipeline.motion.step import RECENT, Step, durations, rates


class Odometry:
    """Measures what the car did since the frame before, of one kind: visual or lidar."""

    def __init__(
        self, kind: str, K: np.ndarray, size: tuple[int, int], camera_height_m: float | None, T_cam_velo: np.ndarray
    ) -> None:
        """`K` [3,3] is for images of `size`; the height corrects depth's scale, None: no; `T_cam_velo` [4,4]."""
        self._visual = visual.Odometry(K, size, camera_height_m) if kind == "visual" else None
        self._lidar = lidar.Odometry(T_cam_velo) if kind == "lidar" else None
        self._times: deque[tuple[int, float]] = deque(maxlen=RECENT + 1)

    def measure(self, moment: Moment) -> tuple[Step | None, Motion]:
        """Return the step since the frame before, None where it is not measured, and what it says, as it is stored."""
        step: Step | None = None
        if self._visual:
            depth_m = to_metres(moment.depth).astype(np.float32)
            step = self._visual.step(visual.View(moment.number, moment.small, depth_m, moment.cls))
        if self._lidar and moment.scan is not None:
            step = self._lidar.step(lidar.Scan(moment.number, moment.scan))
        self._times.append((moment.number, moment.time_s))
        if step is None:
            return None, Motion()
        numbers, times = (np.array(values) for values in zip(*self._times, strict=True))
        yaw_rate_radps, speed_mps = rates(step.T_before, durations(numbers, times)[-1])
        return step, Motion(float(np.float32(yaw_rate_radps)), float(np.float32(speed_mps)), True)


class MeasuredAngle:
    """The steering angle that measured motion says, held while it says nothing."""

    def __init__(self, wheelbase_m: float, min_speed_mps: float) -> None:
        self._car = wheelbase_m, min_speed_mps
        self._last = Motion()  # the last motion that said something

    def of(self, motion: Motion) -> float:
        """Return the angle in rad at the next frame, which moves so."""
        yaw_rate_radps, speed_mps, valid = (np.array(values) for values in zip(self._last, motion, strict=True))
        if valid[1] and abs(speed_mps[1]) >= self._car[1]:
            self._last = motion
        return float(label.measured_angle(yaw_rate_radps, speed_mps, valid, *self._car)[1])
