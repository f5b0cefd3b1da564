"""Measure the motion and the course of a stream of frames with the stages' per-frame functions, without files.

Reading, perception and motion run in threads of their own. Memory holds a few frames.
"""

import math
from collections import deque
from collections.abc import Generator, Iterable, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch

from pipeline.camera.camera import Camera, Frame
from pipeline.camera.images import resized, rounded_as_stored
from pipeline.fitting.prefetch import prefetch
from pipeline.labels.label import Car
from pipeline.motion.estimator import Estimate, MotionEstimator
from pipeline.motion.visual import STANDSTILL, Odometry
from pipeline.perception.depth_scale import DepthPostprocessor
from pipeline.perception.perceive import EncoderInput, open_encoder
from pipeline.sections.perception import Perception

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

    source_image: np.ndarray = field(default_factory=lambda: np.empty(0, np.uint8))  # complete, at the overlay's size
    started_s: float = 0.0  # time.perf_counter() before the frame was read
    driven_rad: float | None = None  # ground truth, where it is known
    driven_mps: float | None = None
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


class Chain:
    """Runs perception and motion on the frames of one drive."""

    def __init__(
        self, camera: Camera, drive: str, encoder: Path | None, kinds: set[str], settings: Perception, road_scale: bool
    ) -> None:
        """Load the encoder of a folder; None: no depth, no classes.

        Args:
            camera: of the images at the encoder's size.
            drive: its name.
            kinds: of motion; visual needs an encoder.
            settings: of perception.
            road_scale: correct depth by the camera's height.
        """
        self._camera, self._drive = camera, drive
        self._encode = open_encoder(encoder, settings.precision) if encoder else None
        self._postprocess = DepthPostprocessor(settings, camera)
        self._estimators = {kind: MotionEstimator(kind, camera, road_scale=road_scale) for kind in kinds}
        odometries = (estimator.odometry for estimator in self._estimators.values())
        self.odometry = next((visual for visual in odometries if isinstance(visual, Odometry)), None)

    def run(self, frames: Generator[FrameState]) -> Generator[FrameState]:
        """Yield each frame with depth, classes and estimates of motion, in order; closes `frames`."""
        return self._measure(prefetch(self._perceive(prefetch(frames, 1)), 1))

    def _perceive(self, frames: Iterable[FrameState]) -> Generator[FrameState]:
        torch.set_num_threads(1)  # of this thread, as in stage perception
        for frame in frames:
            assert frame.image is not None
            frame.image = resized(frame.image, self._camera.size)
            if self._encode:  # depth and classes equal those that stage perception stores
                batch = EncoderInput(self._drive, [frame.number], frame.image[None], self._camera, [frame.scan])
                (depth_m,), (frame.cls,) = self._encode(batch)
                frame.depth_m = rounded_as_stored(self._postprocess(depth_m, frame.cls, frame.scan))
            yield frame

    def _measure(self, frames: Iterable[FrameState]) -> Generator[FrameState]:
        for frame in frames:
            frame.estimates = {kind: estimator.estimate(frame) for kind, estimator in self._estimators.items()}
            if self.odometry:
                frame.problem, frame.road_height_m = self.odometry.problem, self.odometry.road.frame_height_m
            yield frame


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
            frame.image = frame.depth_m = frame.cls = frame.scan = None  # not needed any more
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

    def add(self, frame: FrameState, neighbours: Iterable[FrameState]) -> FrameState:
        """Add the course to the next frame, with means over its `neighbours`, itself included."""
        if frame.estimate:
            measured = [(other.time_s - frame.time_s, other.estimate) for other in neighbours if other.estimate]
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
