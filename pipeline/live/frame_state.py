"""A frame on its way through the chain."""

import math
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from pipeline.camera.frame import Frame
from pipeline.motion.estimator import Estimate


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
    arrays: dict[str, Any] = field(default_factory=dict)  # input of the spatial network, as in pipeline.train.frames
    predicted_rad: float | None = None  # None until the first complete window
    sigma_rad: float | None = None  # of the prediction, by models with uncertainty
    latency_s: float = 0.0  # from `started_s` to the prediction

    @property
    def estimate(self) -> Estimate | None:
        """Visual motion, or from scans where only these are used."""
        return self.estimates.get("visual", self.estimates.get("lidar"))
