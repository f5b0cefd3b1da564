"""The sensors on the car: KITTI's calibration files, camera images and LiDAR scans.

The rig resembles KITTI's: the scanner is 0.8 m in front of the IMU, the cameras 0.27 m in front of
the scanner. Each date has its own cameras, as other cars would, but for three dates with KITTI's.
``T_a_b`` transforms points from frame b to frame a.
"""

import hashlib
from pathlib import Path
from typing import NamedTuple

import numpy as np

from pipeline.camera import classes, geometry
from pipeline.camera.geometry import CAMERA_HEIGHT_M, SCANNER_HEIGHT_M, rigid
from pipeline.camera.images import MAX_UNITS, to_metres
from pipeline.ingest.calibration import CALIBRATION, write_entries
from pipeline.sample.light import Light, shade_pixels
from pipeline.sample.route import IMU_HEIGHT_M, rotation_matrix
from pipeline.sample.world import World, dot_product

# Camera → its offset in metres to the left of camera 0. Cameras 0 and 1 are grey, 2 and 3 are in
# colour.
CAMERAS_LEFT_M = {0: 0.0, 1: -0.537, 2: 0.0622, 3: -0.4706}
# Rotation from the axes forward, left, up to the axes of a camera: right, down, forward.
_FACING = np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]])

# Elevations in degrees of the top and the bottom laser of the HDL-64E.
ELEVATION_DEG = (2.0, -24.8)
# Distance in metres beyond which the scanner has no returns.
SCAN_RANGE_M = 90.0
# Largest depth in metres that is stored.
FARTHEST_M = float(to_metres(np.array(MAX_UNITS)))
# Standard deviation of the scanner's distances in metres.
RANGE_NOISE_M = 0.015
# Resolution in metres to which points are rounded. It is finer than the noise, and stored scans get
# smaller.
_RESOLUTION_M = 1 / 1024
# Reflectance of each class.
_REFLECTANCE = np.full(256, 0.3, np.float32)
_REFLECTANCE[classes.ROAD] = 0.18
_REFLECTANCE[classes.SIDEWALK] = 0.28
_REFLECTANCE[classes.TERRAIN] = 0.35

# Focal length of KITTI's cameras as a share of the image's width.
_FOCAL_PER_WIDTH = 360.8 / 621


class _Optics(NamedTuple):
    """The cameras of a date.

    The scanner has the same height on all dates, so T_cam_velo determines the height of a camera.
    """

    focal: float  # focal length, relative to KITTI's
    x: float  # x of the principal point, as a share of the width
    y: float  # y of the principal point, as a share of the height
    height_m: float  # height over the road


# The cameras of KITTI.
_KITTI = _Optics(1.0, 304.5 / 621, 86.2 / 188, CAMERA_HEIGHT_M)
# Date → its cameras. The cameras of all other dates are drawn.
_OPTICS_OF_DATE = {
    "2026_01_01": _KITTI,
    "2026_01_02": _KITTI,
    "2026_01_03": _KITTI,
    "2026_01_04": _Optics(0.86, 0.506, 0.478, 1.55),
    "2026_01_05": _Optics(1.18, 0.477, 0.441, 1.72),
    "2026_01_06": _Optics(1.06, 0.512, 0.466, 1.76),
    # These are dates of validation (07) and test drives. Their values are within the range of the
    # training dates.
    "2026_01_07": _Optics(0.93, 0.483, 0.470, 1.60),
    "2026_01_09": _Optics(0.90, 0.495, 0.462, 1.58),
    "2026_01_10": _Optics(1.03, 0.486, 0.473, 1.73),
    "2026_01_11": _Optics(1.13, 0.507, 0.449, 1.68),
    "2026_01_12": _Optics(0.97, 0.479, 0.454, 1.62),
    "2026_01_13": _Optics(1.10, 0.499, 0.475, 1.59),
    "2026_01_14": _Optics(0.88, 0.481, 0.446, 1.70),
    "2026_01_15": _Optics(1.05, 0.509, 0.456, 1.64),
    "2026_01_16": _Optics(0.95, 0.493, 0.468, 1.75),
    "2026_01_17": _Optics(1.15, 0.488, 0.459, 1.66),
    "2026_01_18": _Optics(0.91, 0.504, 0.472, 1.74),
    "2026_01_19": _Optics(1.01, 0.497, 0.443, 1.57),
    "2026_01_20": _Optics(1.08, 0.482, 0.464, 1.61),
    "2026_01_21": _Optics(0.94, 0.501, 0.452, 1.69),
    "2026_01_22": _Optics(1.12, 0.485, 0.468, 1.58),
    "2026_01_23": _Optics(0.89, 0.508, 0.461, 1.65),
    "2026_01_24": _Optics(1.06, 0.492, 0.447, 1.73),
}
# Lowest and highest values of cameras that are drawn: those of the table's training dates.
_LOWEST = _Optics(0.86, 0.477, 0.441, 1.55)
_HIGHEST = _Optics(1.18, 0.512, 0.478, 1.76)


class Rig(NamedTuple):
    """Calibration of all sensors, for an image size."""

    size: tuple[int, int]  # [H, W] pixels
    P_rect: dict[int, np.ndarray]  # camera → projection [3,4]
    R_rect: np.ndarray  # [3,3], rectifies camera 0
    T_cam_velo: np.ndarray  # [4,4], to camera 0 before rectification
    T_velo_imu: np.ndarray  # [4,4]

    @property
    def T_cam2_imu(self) -> np.ndarray:
        """Transform [4,4] from the IMU to the rectified left colour camera, as in KITTI's files."""
        P = self.P_rect[2]
        shift = rigid(np.eye(3), [P[0, 3] / P[0, 0], 0, 0])
        return shift @ rigid(self.R_rect, np.zeros(3)) @ self.T_cam_velo @ self.T_velo_imu


def make_rig(size: tuple[int, int], date: str) -> Rig:
    """Return the calibration of a date (2026_01_01) for images of `size` [H, W].

    Pixels are square.
    """
    height, width = size
    optics = _OPTICS_OF_DATE.get(date) or _draw_optics(date)
    f = optics.focal * _FOCAL_PER_WIDTH * width
    K = np.array([[f, 0, optics.x * width], [0, f, optics.y * height], [0, 0, 1]])
    P_rect = {}
    for camera, left_m in CAMERAS_LEFT_M.items():
        P_rect[camera] = np.column_stack([K, [f * left_m, 0.0, 0.0]])

    imu_to_velo = [-0.81, 0.30, IMU_HEIGHT_M - SCANNER_HEIGHT_M]
    T_velo_imu = rigid(rotation_matrix(0.002, -0.0015, 0.001), imu_to_velo)

    # Rectified cameras point straight ahead, but for mounting errors of milliradians. The rotations
    # of the raw camera and of the scanner cancel.
    R_rect = rotation_matrix(-0.004, 0.007, -0.009)
    R_cam_velo = R_rect.T @ rotation_matrix(0.004, -0.002, 0.001) @ _FACING @ T_velo_imu[:3, :3].T
    scanner_to_camera = [0.0, round(optics.height_m - SCANNER_HEIGHT_M, 3), -0.27]
    T_cam_velo = rigid(R_cam_velo, R_rect.T @ scanner_to_camera)
    return Rig(size, P_rect, R_rect, T_cam_velo, T_velo_imu)


def _draw_optics(date: str) -> _Optics:
    """Return the cameras of a date, drawn by its name."""
    digest = hashlib.sha256(date.encode()).digest()
    rng = np.random.default_rng(int.from_bytes(digest[:8], "big"))
    return _Optics(*np.round(rng.uniform(_LOWEST, _HIGHEST), 3).tolist())


def write_calibration(rig: Rig, folder: Path) -> None:
    """Write KITTI's three files of calibration into a date's folder."""
    time = "01-Jan-2026 12:00:00"
    cameras: dict[str, str | np.ndarray] = {
        "dataset": "sample",
        "calib_time": time,
        "corner_dist": "9.950000e-02",
    }
    for camera, P in rig.P_rect.items():
        cameras[f"S_rect_{camera:02d}"] = np.array(rig.size[::-1], float)
        cameras[f"R_rect_{camera:02d}"] = rig.R_rect
        cameras[f"P_rect_{camera:02d}"] = P
    write_entries(folder / CALIBRATION, cameras)
    for name, T in (("velo_to_cam", rig.T_cam_velo), ("imu_to_velo", rig.T_velo_imu)):
        entries: dict[str, str | np.ndarray] = {"calib_time": time, "R": T[:3, :3], "T": T[:3, 3]}
        write_entries(folder / f"calib_{name}.txt", entries)


class ImageSensor:
    """The left colour camera, which renders images, depth and classes."""

    def __init__(self, rig: Rig) -> None:
        self._size = rig.size
        self._T_imu_cam = np.linalg.inv(rig.T_cam2_imu)
        to_pixels = geometry.camera_rays(rig.P_rect[2][:, :3], rig.size).reshape(-1, 3).T
        # Depth along the optical axis per metre of distance.
        self._z_per_m = (1 / np.linalg.norm(to_pixels, axis=0)).astype(np.float32)
        self._directions = (to_pixels * self._z_per_m).astype(np.float32)

    def take_image(
        self, world: World, light: Light, T_world_imu: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return RGB uint8 [H,W,3], depth [H,W] in metres, and classes uint8 [H,W].

        Depth is 0 in the sky and where it is too far to be stored.
        """
        rays = _place_rays(T_world_imu @ self._T_imu_cam, self._directions)
        hits = world.cast_rays(rays)

        # Surfaces that face the sun may be in shadow. Rays to the sun start 1 cm above a surface,
        # since otherwise it would shade itself. The sky has no normal, and casts no rays.
        facing = np.flatnonzero(dot_product(hits.normal, light.sun) > 0)
        points = rays[:3, facing] + hits.distance_m[facing] * rays[3:, facing]
        points += np.float32(0.01) * hits.normal[:, facing]
        lit = np.zeros(rays.shape[1], bool)
        lit[facing] = world.find_lit(points, light.sun)
        image = shade_pixels(light, hits, rays, lit, self._size)

        depth_m = hits.distance_m * self._z_per_m  # infinite for the sky
        depth_m = np.where(depth_m < FARTHEST_M, depth_m, 0)
        return image, depth_m.reshape(self._size), hits.cls.reshape(self._size)


class Scanner:
    """A spinning LiDAR. Its scans are instantaneous, as KITTI's are motion-compensated."""

    def __init__(self, rig: Rig, rays: tuple[int, int]) -> None:
        """Store the directions of `rays`, the number of rings and the number of rays per ring."""
        rings, per_ring = rays
        self._T_imu_velo = np.linalg.inv(rig.T_velo_imu)
        elevation = np.deg2rad(np.linspace(*ELEVATION_DEG, rings))[:, None]
        azimuth = np.arange(per_ring) * 2 * np.pi / per_ring
        x = np.cos(elevation) * np.cos(azimuth)  # [rings,per_ring]
        y = np.cos(elevation) * np.sin(azimuth)
        z = np.broadcast_to(np.sin(elevation), x.shape)
        self._directions = np.stack([x, y, z]).reshape(3, -1).astype(np.float32)

    def take_scan(
        self, world: World, T_world_imu: np.ndarray, rng: np.random.Generator
    ) -> np.ndarray:
        """Return a scan float32 [P,4]: x, y, z in the velodyne frame, and reflectance in 0..1."""
        rays = _place_rays(T_world_imu @ self._T_imu_velo, self._directions)
        hits = world.cast_rays(rays)
        distance_m = hits.distance_m + rng.normal(0, RANGE_NOISE_M, rays.shape[1])
        gloss = rng.uniform(0.6, 1.0, rays.shape[1])
        reflectance = _REFLECTANCE[hits.cls] + 0.5 * hits.colour.mean(axis=0) * gloss
        reflectance = np.round(np.clip(reflectance, 0, 0.99), 2)

        in_range = np.flatnonzero(hits.distance_m < SCAN_RANGE_M)
        xyz = self._directions[:, in_range] * distance_m[in_range]
        xyz = np.rint(xyz / _RESOLUTION_M) * _RESOLUTION_M
        return np.stack([*xyz, reflectance[in_range]], axis=-1).astype(np.float32)


def _place_rays(T_world_sensor: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Return the rays [6,N] of a sensor in the world; `directions` [3,N] are in its own frame."""
    rays = np.empty((6, directions.shape[1]), np.float32)
    rays[:3] = T_world_sensor[:3, 3:]
    rotation_rows = T_world_sensor[:3, :3].astype(np.float32)
    rays[3:] = [dot_product(directions, row) for row in rotation_rows]
    return rays
