"""A frame of a stream, and the car's course up to it: rates, curvature, steering angle, and the track."""

import math
from collections import deque
from collections.abc import Generator, Iterable, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from pipeline.camera.frame import Frame
from pipeline.labels.label import Car
from pipeline.motion.estimator import Estimate
from pipeline.motion.visual import STANDSTILL

# Standard deviations of Gaussian means. A driver turns the wheel in a second, and a car changes its speed more slowly;
# a speed from one pair of images has much more noise than a yaw rate.
YAW_SIGMA_S, SPEED_SIGMA_S = 0.2, 0.5
REACH = 2.0  # sigmas on both sides
BRIDGED_S = 1.0  # longest gap over which the track continues with the last motion


class Course(NamedTuple):
    """Measured motion of the car, left and forward positive, and its pose relative to the first frame."""

    speed_mps: float
    yaw_rate_radps: float
    curvature_1pm: float | None  # None below the minimum speed
    steering_rad: float | None
    x_m: float  # ahead
    y_m: float  # to the left
    heading_rad: float


@dataclass
class FrameState(Frame):
    """A frame of a source, and the results of the steps for it."""

    source_image: np.ndarray = field(default_factory=lambda: np.empty(0, np.uint8))  # RGB uint8, at the source's size
    started_s: float = 0.0  # time.perf_counter() before the frame was read
    driven_rad: float | None = None  # ground truth from oxts, where the source has it
    estimates: dict[str, Estimate | None] = field(default_factory=dict)  # by kind of motion
    problem: str = ""  # why no visual motion could be measured
    road_height_m: float = math.nan  # of the camera over the road, by the encoder's depth
    course: Course | None = None
    arrays: dict[str, Any] = field(default_factory=dict)  # input of the spatial network, see graph_file.single
    predicted_rad: float | None = None  # None until the first complete window
    sigma_rad: float | None = None  # of the prediction, by models with uncertainty
    latency_s: float = 0.0  # from `started_s` to the prediction

    @property
    def estimate(self) -> Estimate | None:
        """Visual motion, or from scans where only these are used."""
        return self.estimates.get("visual", self.estimates.get("lidar"))


def add_courses(frames: Generator[FrameState], car: Car, smooth: bool) -> Generator[FrameState]:
    """Add the course to each frame whose motion is measured; closes `frames`.

    Args:
        frames: in order.
        car: for the steering angle.
        smooth: take means over neighbouring frames, later ones included, so frames come a second late.
    """
    track = _Track(car)
    recent: deque[FrameState] = deque()
    waiting = 0  # index in `recent` of the first frame without a course
    reach_s = REACH * max(YAW_SIGMA_S, SPEED_SIGMA_S) if smooth else 0.0
    with closing(frames):
        for frame in frames:
            frame.depth_m = frame.cls = frame.scan = None  # not needed any more
            recent.append(frame)
            while waiting < len(recent) and recent[waiting].time_s <= frame.time_s - reach_s:
                yield track.add(recent[waiting], recent)
                waiting += 1
            while recent[0].time_s < recent[min(waiting, len(recent) - 1)].time_s - reach_s:
                recent.popleft()
                waiting -= 1
    for late in list(recent)[waiting:]:
        yield track.add(late, recent)


class _Track:
    """Integrates the motion of frames in order."""

    def __init__(self, car: Car) -> None:
        self._car = car
        self._x_m = self._y_m = self._heading_rad = 0.0
        self._yaw_rate_radps = self._speed_mps = 0.0
        self._measured_s, self._last_s = -math.inf, math.nan

    def add(self, frame: FrameState, around: Iterable[FrameState]) -> FrameState:
        """Add the course to the next frame, with means over the frames `around` it."""
        if frame.estimate:
            measured = [(near.time_s - frame.time_s, near.estimate) for near in around if near.estimate]
            self._yaw_rate_radps = _mean([(s, estimate.yaw_rate_radps) for s, estimate in measured], YAW_SIGMA_S)
            self._speed_mps = _mean([(s, estimate.speed_mps) for s, estimate in measured], SPEED_SIGMA_S)
            self._measured_s = frame.time_s
        elif frame.problem in STANDSTILL or frame.time_s - self._measured_s > BRIDGED_S:
            self._yaw_rate_radps = self._speed_mps = 0.0
        step_s = 0.0 if math.isnan(self._last_s) else frame.time_s - self._last_s
        self._last_s = frame.time_s
        turned_rad = self._yaw_rate_radps * step_s
        self._x_m += self._speed_mps * step_s * math.cos(self._heading_rad + turned_rad / 2)
        self._y_m += self._speed_mps * step_s * math.sin(self._heading_rad + turned_rad / 2)
        self._heading_rad += turned_rad
        if frame.estimate:
            curvature_1pm = steering_rad = None
            if abs(self._speed_mps) >= self._car.min_speed_mps:
                curvature_1pm = self._yaw_rate_radps / self._speed_mps
                steering_rad = math.atan(self._car.wheelbase_m * curvature_1pm)
            rates = self._speed_mps, self._yaw_rate_radps, curvature_1pm, steering_rad
            frame.course = Course(*rates, self._x_m, self._y_m, self._heading_rad)
        return frame


def _mean(values: Sequence[tuple[float, float]], sigma_s: float) -> float:
    """Return the Gaussian mean of (seconds from the centre, value)."""
    weights = [math.exp(-((seconds / sigma_s) ** 2) / 2) * (abs(seconds) <= REACH * sigma_s) for seconds, _ in values]
    return sum(weight * value for weight, (_, value) in zip(weights, values, strict=True)) / sum(weights)
