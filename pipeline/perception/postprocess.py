"""From the network's depth to stored depth, frame by frame: scale, limit of traffic, units."""

import numpy as np

from pipeline.camera import classes
from pipeline.camera.images import to_units
from pipeline.perception.depth_scale import MODES, DepthFrame
from pipeline.perception.ground_plane import limit_traffic_depth
from pipeline.sections.perception import Perception


class DepthPostprocessor:
    """Scales the depth of one drive; frames come in order."""

    def __init__(self, settings: Perception, K: np.ndarray, camera_height_m: float) -> None:
        """`K` [3,3] at the size of the depth; the camera's height is over the road."""
        self._scale, self._reach = MODES[settings.depth_scale], settings.reach
        self._K, self._camera_height_m = K, camera_height_m
        self._factor = 0.0  # no depth before the first frame with a known scale

    def __call__(self, depth: np.ndarray, cls: np.ndarray, scan_m: np.ndarray | None) -> np.ndarray:
        """Return the stored depth of a frame, uint16 [H,W], 0 in the sky; see :func:`pipeline.camera.images.to_units`.

        Args:
            depth: float32 [H,W] in the network's unit; overwritten.
            cls: trainIds [H,W].
            scan_m: depth [H,W] in metres of the frame's LiDAR scan, 0 = none; None without a scan.
        """
        frame = DepthFrame(depth, cls, scan_m, self._K, self._camera_height_m)
        self._factor = self._scale.rescale(frame, self._factor)
        if self._reach:
            limit_traffic_depth(depth, cls, self._K, self._camera_height_m, self._reach)
        return to_units(np.where(cls == classes.SKY, 0, depth))
