"""One frame of a drive, the input of the stages' per-frame functions."""

from dataclasses import dataclass

import numpy as np


@dataclass
class Frame:
    """Sensor data and perception of one frame; None where the frame lacks it."""

    number: int  # KITTI's, or counted from 0
    time_s: float  # since the start of the drive
    image: np.ndarray | None = None  # RGB uint8 [H,W,3], at the size of depth and classes
    depth_m: np.ndarray | None = None  # [H,W] metres, rounded as in the file of stage perception; 0: none
    cls: np.ndarray | None = None  # trainIds uint8 [H,W]
    scan: np.ndarray | None = None  # float32 [P,4] in the velodyne frame: x, y, z in metres, reflectance
