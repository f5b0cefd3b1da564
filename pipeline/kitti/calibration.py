"""KITTI raw's calibration: one camera's rectified image size, intrinsics and pose relative to the LiDAR.

pykitti's ``raw`` class is not used: it needs all four cameras.
"""

from pathlib import Path

import numpy as np

from pipeline.base.errors import InputError, error_context
from pipeline.camera.camera import Camera
from pipeline.camera.intrinsics import matrix, projection, read_entries, rotation
from pipeline.camera.mount import camera_height

_EXTRACT = "Extract the date's calibration archive (…_calib.zip) again"
_FARTHEST_M = 20.0  # between LiDAR and camera


def cameras_in(folder: Path) -> list[int]:
    """Return the camera numbers in a date folder's ``calib_cam_to_cam.txt``; none without the file."""
    path = folder / "calib_cam_to_cam.txt"
    with error_context(fix=_EXTRACT):
        entries = read_entries(path) if path.is_file() else {}
    return [number for number in range(4) if f"P_rect_{number:02d}" in entries]


def read_calibration(folder: Path, number: int) -> Camera:
    """Read camera `number` from a date folder's files. Raises InputError for missing or wrong entries."""
    path, velo = folder / "calib_cam_to_cam.txt", folder / "calib_velo_to_cam.txt"
    with error_context(fix=_EXTRACT):
        entries = read_entries(path)
        P, size = projection(entries, number, path)
        K = P[:, :3]
        if not velo.exists():
            return Camera(K, size)
        # P_rect projects from the reference camera's frame, P = K [I | t]: t shifts points to this camera. All three
        # components count: with x alone (as in pykitti) depths are off by t_z, 3 mm.
        shift = _rigid(np.eye(3), np.linalg.solve(K, P[:, 3]))
        rectify = _rigid(rotation(entries, "R_rect_00", path), np.zeros(3))
        entries = read_entries(velo)
        t = matrix(entries, "T", (3,), velo)
        if np.abs(t).max() > _FARTHEST_M:
            raise InputError(f"T puts the LiDAR {np.abs(t).max():g} m away from the camera", velo)
        T_cam_velo = shift @ rectify @ _rigid(rotation(entries, "R", velo), t)
        return Camera(K, size, camera_height(T_cam_velo), T_cam_velo)


def _rigid(R: np.ndarray, t: np.ndarray) -> np.ndarray:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, t
    return T
