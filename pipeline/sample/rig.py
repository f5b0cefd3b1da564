"""Place the sensors on the car and write KITTI's calibration files.

The rig resembles KITTI's: the scanner is 0.8 m in front of the IMU, the cameras 0.27 m in front of the scanner. Some
dates have other cameras, as other cars would. ``T_a_b`` takes points from frame b to frame a.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pipeline.camera.camera import Camera
from pipeline.camera.geometry import CAMERA_HEIGHT_M, SCANNER_HEIGHT_M
from pipeline.kitti.raw import write_entries
from pipeline.sample.route import IMU_HEIGHT_M

CAMERAS_LEFT_M = {0: 0.0, 1: -0.537, 2: 0.0622, 3: -0.4706}  # of camera 0: grey left, right, colour left, right
_LEVEL = np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]])  # x forward, y left, z up -> x right, y down, z forward


@dataclass(frozen=True)
class Cameras:
    """Optics and height of a car's cameras."""

    focal_per_width: float
    principal_point: tuple[float, float]  # as shares of width and height
    height_m: float  # the scanner's is constant, so that T_cam_velo determines it


_KITTI = Cameras(360.8 / 621, (304.5 / 621, 86.2 / 188), CAMERA_HEIGHT_M)
_CAMERAS_OF_DATE = {
    "2026_01_04": Cameras(0.86 * _KITTI.focal_per_width, (0.506, 0.478), 1.55),
    "2026_01_05": Cameras(1.18 * _KITTI.focal_per_width, (0.477, 0.441), 1.72),
    "2026_01_06": Cameras(1.06 * _KITTI.focal_per_width, (0.512, 0.466), 1.76),
    # Of validation (07) and test drives, within the range of the training dates.
    "2026_01_07": Cameras(0.93 * _KITTI.focal_per_width, (0.483, 0.470), 1.60),
    "2026_01_09": Cameras(0.90 * _KITTI.focal_per_width, (0.495, 0.462), 1.58),
    "2026_01_10": Cameras(1.03 * _KITTI.focal_per_width, (0.486, 0.473), 1.73),
    "2026_01_11": Cameras(1.13 * _KITTI.focal_per_width, (0.507, 0.449), 1.68),
    "2026_01_12": Cameras(0.97 * _KITTI.focal_per_width, (0.479, 0.454), 1.62),
}


@dataclass(frozen=True)
class Rig:
    """Calibration for one image size."""

    size: tuple[int, int]  # [H, W] pixels
    P_rect: dict[int, np.ndarray]  # camera -> [3,4]
    R_rect: np.ndarray  # [3,3] of camera 0
    T_cam_velo: np.ndarray  # [4,4] to camera 0 before rectification
    T_velo_imu: np.ndarray  # [4,4]

    @property
    def camera(self) -> Camera:
        """The left colour camera, without its pose."""
        return Camera(self.P_rect[2][:, :3], self.size)

    @property
    def T_cam2_imu(self) -> np.ndarray:
        """Transform [4,4] from the IMU to the rectified left colour camera, as computed from the files."""
        shift, rectify = np.eye(4), np.eye(4)
        shift[0, 3] = self.P_rect[2][0, 3] / self.P_rect[2][0, 0]
        rectify[:3, :3] = self.R_rect
        return shift @ rectify @ self.T_cam_velo @ self.T_velo_imu


def make_rig(size: tuple[int, int], date: str) -> Rig:
    """Return the calibration of a date (2026_01_01) for images of `size` [H, W], of square pixels."""
    height, width = size
    cameras = _CAMERAS_OF_DATE.get(date, _KITTI)
    f, (x, y) = cameras.focal_per_width * width, cameras.principal_point
    K = np.array([[f, 0, x * width], [0, f, y * height], [0, 0, 1]])
    P = {n: np.column_stack([K, [f * left, 0.0, 0.0]]) for n, left in CAMERAS_LEFT_M.items()}
    T_velo_imu = np.eye(4)
    T_velo_imu[:3, :3] = rotation(0.002, -0.0015, 0.001)
    T_velo_imu[:3, 3] = -0.81, 0.30, IMU_HEIGHT_M - SCANNER_HEIGHT_M
    R_rect = rotation(-0.004, 0.007, -0.009)
    T_cam_velo = np.eye(4)
    # Rectified cameras point straight ahead up to mounting errors of milliradians; the tilts of raw camera and scanner
    # cancel.
    T_cam_velo[:3, :3] = R_rect.T @ rotation(0.004, -0.002, 0.001) @ _LEVEL @ T_velo_imu[:3, :3].T
    T_cam_velo[:3, 3] = R_rect.T @ [0.0, round(cameras.height_m - SCANNER_HEIGHT_M, 3), -0.27]
    return Rig(size, P, R_rect, T_cam_velo, T_velo_imu)


def rotation(x: float, y: float, z: float) -> np.ndarray:
    """Return the rotation [3,3] about x, then y, then z, by angles in rad."""
    R = np.eye(3)
    for axis, angle in enumerate((x, y, z)):
        c, s = np.cos(angle), np.sin(angle)
        i, j = (axis + 1) % 3, (axis + 2) % 3
        turn = np.eye(3)
        turn[i, i], turn[i, j], turn[j, i], turn[j, j] = c, -s, s, c
        R = turn @ R
    return R


def write_calibration(rig: Rig, folder: Path) -> None:
    """Write calib_cam_to_cam.txt, calib_velo_to_cam.txt and calib_imu_to_velo.txt into a date's folder."""
    time = {"calib_time": "01-Jan-2026 12:00:00"}
    cameras: dict[str, str | np.ndarray] = {**time, "corner_dist": "9.950000e-02"}
    for camera, P in rig.P_rect.items():
        cameras[f"S_rect_{camera:02d}"] = np.array(rig.size[::-1], float)
        cameras[f"R_rect_{camera:02d}"] = rig.R_rect
        cameras[f"P_rect_{camera:02d}"] = P
    write_entries(folder / "calib_cam_to_cam.txt", cameras)
    for name, T in (("velo_to_cam", rig.T_cam_velo), ("imu_to_velo", rig.T_velo_imu)):
        write_entries(folder / f"calib_{name}.txt", {**time, "R": T[:3, :3], "T": T[:3, 3]})
