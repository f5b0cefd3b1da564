"""KITTI raw's calibration files: one camera's rectified image size, intrinsics and pose relative to the LiDAR.

What pykitti's ``raw`` class makes of them is not used: it needs all four cameras, and users have files with only some.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pipeline.base.errors import InputError, error_context
from pipeline.camera.calib_file import matrix, projection, read_entries, rotation

_AGAIN = "Extract the date's calibration archive (…_calib.zip) again"
_FARTHEST_M = 20.0  # of LiDAR and camera on a car


@dataclass(frozen=True)
class Camera:
    """A rectified camera. Its frame: x right, y down, z forward, with the projection centre of this very camera."""

    number: int
    size: tuple[int, int]
    """(H, W) pixels."""
    K: np.ndarray
    """[3,3]"""
    T_cam_velo: np.ndarray | None
    """[4,4]; None where ``calib_velo_to_cam.txt`` is absent."""


def cameras_in(folder: Path) -> list[int]:
    """Return the numbers of the cameras that a date's ``calib_cam_to_cam.txt`` describes; none if it is absent."""
    path = folder / "calib_cam_to_cam.txt"
    with error_context(fix=_AGAIN):
        entries = read_entries(path) if path.is_file() else {}
    return [number for number in range(4) if f"P_rect_{number:02d}" in entries]


def read_camera(folder: Path, number: int) -> Camera:
    """Read camera `number` from a date folder's calibration files. Raises InputError if they lack what it needs."""
    path, velo = folder / "calib_cam_to_cam.txt", folder / "calib_velo_to_cam.txt"
    with error_context(fix=_AGAIN):
        entries = read_entries(path)
        P, size = projection(entries, number, path)
        K = P[:, :3]
        T_cam_velo = None
        if velo.exists():
            # P_rect projects points of the reference camera's frame: P = K [I | t], so t is where this camera sees
            # them. All three components of t: with x alone (as pykitti has it) depths are off by t_z, 3 mm.
            shift = _rigid(np.eye(3), np.linalg.solve(K, P[:, 3]))
            rectify = _rigid(rotation(entries, "R_rect_00", path), np.zeros(3))
            entries = read_entries(velo)
            T_ref_velo = _rigid(rotation(entries, "R", velo), _place(entries, velo))
            T_cam_velo = shift @ rectify @ T_ref_velo
    return Camera(number, size, K, T_cam_velo)


def _place(entries: Mapping[str, np.ndarray], path: Path) -> np.ndarray:
    T = matrix(entries, "T", (3,), path)
    if np.abs(T).max() > _FARTHEST_M:
        raise InputError(f"{path}: T puts the LiDAR {np.abs(T).max():g} m away from the camera")
    return T


def _rigid(R: np.ndarray, t: np.ndarray) -> np.ndarray:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, t
    return T
