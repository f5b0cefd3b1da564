"""Measure the motion and the course of a stream of frames with the stages' per-frame functions, without files.

Reading, perception and motion run in threads of their own. Memory holds a few frames.
"""

import math
from collections.abc import Generator, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch

from pipeline.camera.camera import Camera, Frame
from pipeline.camera.images import resized, rounded_as_stored
from pipeline.motion.step import Step, StepClock, rates
from pipeline.motion.visual import Odometry
from pipeline.perception.depth_scale import DepthPostprocessor
from pipeline.perception.perceive import EncoderInput, open_encoder
from pipeline.settings.perception import Perception
from pipeline.train.prefetch import prefetch


class Estimate(NamedTuple):
    """Measured motion: mean rates over the step, left and forward positive."""

    step: Step
    yaw_rate_radps: float
    speed_mps: float


class Course(NamedTuple):
    """Measured motion of the car, left and forward positive, and its pose relative to the first frame."""

    speed_mps: float
    yaw_rate_radps: float
    curvature_1pm: float | None  # None below the minimum speed
    steering_rad: float | None
    x_m: float  # ahead
    y_m: float  # to the left
    heading_rad: float
    speed_sigma: float = 0.0  # relative standard deviation
    steering_sigma_rad: float | None = None


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
    path_1pm: Sequence[float] | None = None  # predicted curvature by range of the path ahead, by models of the path
    path_sigma_1pm: Sequence[float] | None = None  # of the path, by models with uncertainty
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
        self.odometry = Odometry(camera, road_scale=road_scale) if kinds else None
        self._clock = StepClock()

    def run(self, frames: Generator[FrameState]) -> Generator[FrameState]:
        """Yield each frame with depth, classes and estimates of motion, in order; closes `frames`."""
        return self._measure(prefetch(self._perceive(prefetch(frames, 1)), 1))

    def _perceive(self, frames: Iterable[FrameState]) -> Generator[FrameState]:
        torch.set_num_threads(1)  # of this thread, as in stage perception
        for frame in frames:
            assert frame.image is not None
            frame.image = resized(frame.image, self._camera.size)
            if self._encode:  # depth and classes equal those that stage perception stores
                batch = EncoderInput(self._drive, [frame.number], frame.image[None], self._camera)
                (depth_m,), (frame.cls,) = self._encode(batch)
                frame.depth_m = rounded_as_stored(self._postprocess(depth_m, frame.cls))
            yield frame

    def _measure(self, frames: Iterable[FrameState]) -> Generator[FrameState]:
        for frame in frames:
            if self.odometry:
                step, duration_s = self.odometry.step(frame), self._clock.duration(frame.number, frame.time_s)
                frame.estimates = {"visual": Estimate(step, *rates(step.T_before, duration_s)) if step else None}
                frame.problem, frame.road_height_m = (
                    self.odometry.problem,
                    self.odometry.road.frame_height_m or math.nan,
                )
            yield frame
