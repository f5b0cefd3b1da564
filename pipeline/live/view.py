"""The camera that a source's images are of."""

from dataclasses import dataclass

import numpy as np

from pipeline.camera.geometry import scale_K
from pipeline.camera.images import Size


@dataclass(frozen=True)
class View:
    """A rectified pinhole camera, and what its images are called."""

    name: str  # of the drive; random draws depend on it
    size: Size  # (H, W) of the source's images, in pixels
    K: np.ndarray  # [3,3] for that size
    T_cam_velo: np.ndarray | None = None  # [4,4], where that is calibrated
    scans: bool = False  # whether frames come with LiDAR scans

    def K_at(self, size: Size) -> np.ndarray:
        """Return the intrinsics [3,3] of images resized to `size`."""
        return scale_K(self.K, self.size, size)
