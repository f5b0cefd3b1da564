"""Camera height above the ground, from the calibration against KITTI's scanner, which has a fixed height."""

import numpy as np

from pipeline.base.errors import InputError

SCANNER_HEIGHT_M = 1.73  # above flat ground (KITTI's setup page); the sample uses the same
CAMERA_HEIGHT_M = 1.65  # of a camera without calibration: KITTI's (same page)
LOWEST_M, HIGHEST_M = 0.3, 5.0  # outside of it, the scanner is not at KITTI's height


def camera_height(T_cam_velo: np.ndarray | None) -> float:
    """Return a camera's height above flat ground in metres from its calibration [4,4]; KITTI's if it is None."""
    if T_cam_velo is None:
        return CAMERA_HEIGHT_M
    return SCANNER_HEIGHT_M + float(np.linalg.inv(T_cam_velo)[2, 3])  # the scanner's z points up


def check_height(height_m: float) -> None:
    """Raise InputError if the height of a calibrated camera is implausible."""
    if not LOWEST_M <= height_m <= HIGHEST_M:
        raise InputError(
            f"calibration puts the camera {height_m:.2f} m above the ground (expected {LOWEST_M} to {HIGHEST_M} m), "
            f"assuming KITTI's scanner at {SCANNER_HEIGHT_M} m",
            fix="Set perception.camera_height_m",
        )
