"""What is known of a frame while it goes through the chain."""

from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np


class Motion(NamedTuple):
    """What the car did since the frame before, left and forward +; all 0 where it is not valid."""

    yaw_rate_radps: float = 0.0
    speed_mps: float = 0.0
    valid: bool = False


@dataclass
class Moment:
    """A frame as a source gives it, and what each step of the chain adds."""

    number: int  # KITTI's, or counted from 0
    time_s: float  # since the source's first frame
    image: np.ndarray  # RGB uint8 [H,W,3], at the source's size
    began_s: float  # on the clock of time.perf_counter, before it was read
    scan: np.ndarray | None = None  # float32 [P,4] in the velodyne frame, metres and reflectance
    driven_rad: float | None = None  # by oxts, where the source has them
    small: np.ndarray = field(default_factory=lambda: np.empty(0, np.uint8))  # the image at the encoder's size
    depth: np.ndarray = field(default_factory=lambda: np.empty(0, np.uint16))  # [H,W] as stored, see images.to_metres
    cls: np.ndarray = field(default_factory=lambda: np.empty(0, np.uint8))  # trainIds [H,W]
    motion: Motion = field(default_factory=Motion)  # of the kind that the network is told of
    T_before: np.ndarray | None = None  # float64 [4,4], the step in lengths of the clouds, if they span time
    arrays: dict[str, Any] = field(default_factory=dict)  # what the spatial network takes, as in pipeline.train.frames
    predicted_rad: float | None = None  # None until a whole window was seen
    latency_s: float = 0.0  # from before it was read until its angle was known
