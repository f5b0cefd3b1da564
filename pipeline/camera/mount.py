"""How high a camera stands: KITTI's scanner is at one height, and its calibration tells a camera's place against it."""

import numpy as np

from pipeline.base.errors import InputError

SCANNER_HEIGHT_M = 1.73  # above a flat ground, by KITTI's setup page; the sample's, too
CAMERA_HEIGHT_M = 1.65  # of a camera without that calibration: KITTI's by the same page
LOWEST_M, HIGHEST_M = 0.3, 5.0  # a camera beyond them is on no car of which the scanner's height is known


def camera_height(T_cam_velo: np.ndarray | None) -> float:
    """Return a camera's height over a flat ground in metres, of the calibration [4,4]; KITTI's if it is None.

    Raises InputError if the camera cannot be at such a height.
    """
    if T_cam_velo is None:
        return CAMERA_HEIGHT_M
    height_m = SCANNER_HEIGHT_M + float(np.linalg.inv(T_cam_velo)[2, 3])  # the scanner's z points up
    if not LOWEST_M <= height_m <= HIGHEST_M:
        raise InputError(
            f"the calibration says that the camera stands {height_m:.2f} m over the ground, with KITTI's scanner at "
            f"{SCANNER_HEIGHT_M} m: set perception.camera_height_m"
        )
    return height_m
