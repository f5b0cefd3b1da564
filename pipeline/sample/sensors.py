"""Render camera images and LiDAR scans."""

import numpy as np

from pipeline.camera import classes, geometry
from pipeline.camera.images import MAX_UNITS, to_metres
from pipeline.sample.light import Light, shade
from pipeline.sample.rig import Rig
from pipeline.sample.world import World, dot

ELEVATION_DEG = (2.0, -24.8)  # of the HDL-64E's lasers, top to bottom
SCAN_RANGE_M = 90.0
FARTHEST_M = float(to_metres(np.array(MAX_UNITS)))  # of stored depth
RANGE_NOISE_M = 0.015
_RESOLUTION_M = 1 / 1024  # of points: finer than the noise, and stored scans are smaller
_REFLECTANCE = np.full(256, 0.3, np.float32)
_REFLECTANCE[[classes.ROAD, classes.SIDEWALK, classes.TERRAIN, classes.VEGETATION]] = 0.18, 0.28, 0.35, 0.3


class ImageSensor:
    """The left colour camera: renders images, depth and classes."""

    def __init__(self, rig: Rig) -> None:
        self._size = rig.size
        forward = geometry.rays(rig.camera.K, rig.size).reshape(-1, 3).T
        self._z_per_m = (1 / np.linalg.norm(forward, axis=0)).astype(np.float32)  # depth along the axis per distance
        self._directions = (forward * self._z_per_m).astype(np.float32)
        self._T_imu_cam = np.linalg.inv(rig.T_cam2_imu)

    def take(self, world: World, light: Light, T_world_imu: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return RGB uint8 [H,W,3], depth [H,W] in metres (0: sky or too far to be stored), classes uint8 [H,W]."""
        rays = _rays(T_world_imu @ self._T_imu_cam, self._directions)
        hits = world.cast(rays)
        facing = np.flatnonzero(dot(hits.normal, light.sun.astype(np.float32)) > 0)  # the sky has no normal
        points = rays[:3, facing] + hits.distance_m[facing] * rays[3:, facing]
        points += np.float32(0.01) * hits.normal[:, facing]  # off the surface, which would shade itself
        lit = np.zeros(rays.shape[1], bool)
        lit[facing] = world.lit(points, light.sun)
        picture = shade(light, hits, rays, lit, self._size)
        depth_m = hits.distance_m * self._z_per_m  # sky: inf
        depth_m = np.where(depth_m < FARTHEST_M, depth_m, 0)
        return picture, depth_m.reshape(self._size), hits.cls.reshape(self._size)


class Scanner:
    """A spinning LiDAR with instantaneous scans (KITTI's are motion-compensated)."""

    def __init__(self, rig: Rig, rays: tuple[int, int]) -> None:
        rings, per_ring = rays
        elevation = np.deg2rad(np.linspace(*ELEVATION_DEG, rings))[:, None]
        azimuth = np.arange(per_ring)[None] * 2 * np.pi / per_ring
        level = np.stack([np.cos(azimuth), np.sin(azimuth), 0 * azimuth])
        up = np.array([0.0, 0.0, 1.0])[:, None, None]
        directions = np.cos(elevation) * level + np.sin(elevation) * up  # [3,rings,per_ring]
        self._directions = directions.reshape(3, -1).astype(np.float32)
        self._T_imu_velo = np.linalg.inv(rig.T_velo_imu)

    def take(self, world: World, T_world_imu: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Return the scan float32 [P,4]: x, y, z in the velodyne frame, reflectance 0..1."""
        rays = _rays(T_world_imu @ self._T_imu_velo, self._directions)
        hits = world.cast(rays)
        distance = hits.distance_m + rng.normal(0, RANGE_NOISE_M, rays.shape[1])
        reflectance = _REFLECTANCE[hits.cls] + 0.5 * hits.colour.mean(axis=0) * rng.uniform(0.6, 1.0, rays.shape[1])
        in_range = np.flatnonzero(hits.distance_m < SCAN_RANGE_M)
        xyz = np.rint(self._directions[:, in_range] * distance[in_range] / _RESOLUTION_M) * _RESOLUTION_M
        return np.stack([*xyz, np.round(np.clip(reflectance[in_range], 0, 0.99), 2)], axis=-1).astype(np.float32)


def _rays(T_world_sensor: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Return the rays [6,N] of a sensor with viewing `directions` float32 [3,N]."""
    rays = np.empty((6, directions.shape[1]), np.float32)
    rays[:3] = T_world_sensor[:3, 3:]
    for axis, row in enumerate(T_world_sensor[:3, :3].astype(np.float32)):
        rays[3 + axis] = dot(directions, row)
    return rays
