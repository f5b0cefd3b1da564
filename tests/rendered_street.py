"""A street with a textured road and houses, rendered exactly from wherever the camera is: known motion, known depth."""

from functools import cache

import cv2
import numpy as np

from pipeline.camera import classes
from pipeline.camera.camera import Camera
from pipeline.camera.geometry import rays
from pipeline.camera.mount import CAMERA_HEIGHT_M

SIZE, FINER = (96, 320), 2
K = np.array([[180.0, 0.0, 159.5], [0.0, 180.0, 44.0], [0.0, 0.0, 1.0]])
CAMERA = Camera(K, SIZE)
HALF_WIDTH_M, END_M, ROOF_M = 7.0, 60.0, 5.0


@cache
def _noise(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).uniform(0, 255, (256, 256)).astype(np.float32)


def _texture(a: np.ndarray, b: np.ndarray, seed: int) -> np.ndarray:
    """Return brightness at places in metres on a surface: noise at 0.4, 1.6 and 6.4 m."""
    total = np.zeros_like(a)
    for octave, grain_m in enumerate((0.4, 1.6, 6.4)):
        u, v = (np.float32(np.mod(axis / grain_m, 250)) for axis in (a, b))
        total += cv2.remap(_noise(10 * seed + octave), u, v, cv2.INTER_LINEAR)
    return total / 3


def view(T_world_cam: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return image uint8 [H,W,3], depth float32 [H,W] in metres, 0 in the sky, and trainIds, as seen from a pose.

    The world's frame is that of a camera at the beginning of the street, which leads along z.
    """
    fine = SIZE[0] * FINER, SIZE[1] * FINER
    K_fine = Camera(K, SIZE).scaled(fine).K
    grey, *_ = _render(T_world_cam, K_fine, fine)  # aliases of a coarse image would not move as it does
    image = cv2.resize(grey, SIZE[::-1], interpolation=cv2.INTER_AREA).astype(np.uint8)
    _, depth, which, sky = _render(T_world_cam, K, SIZE)
    cls = np.where(sky, classes.SKY, np.where(which == 0, classes.ROAD, classes.BUILDING)).astype(np.uint8)
    return np.repeat(image[..., None], 3, axis=-1), np.where(sky, 0, depth).astype(np.float32), cls


def _render(T_world_cam: np.ndarray, K: np.ndarray, size: tuple[int, int]) -> tuple[np.ndarray, ...]:
    """Return brightness, depth, the number of the plane and whether it is sky, each [H,W]."""
    direction = rays(K, size) @ T_world_cam[:3, :3].T  # of depth 1
    origin = T_world_cam[:3, 3]
    with np.errstate(divide="ignore"):
        planes = [
            (CAMERA_HEIGHT_M - origin[1]) / direction[..., 1],
            (-HALF_WIDTH_M - origin[0]) / direction[..., 0],
            (HALF_WIDTH_M - origin[0]) / direction[..., 0],
            (END_M - origin[2]) / direction[..., 2],
        ]
    depth = np.stack([np.where(plane > 0, plane, np.inf) for plane in planes])
    which, depth = depth.argmin(axis=0), depth.min(axis=0)
    place = origin + direction * np.where(np.isfinite(depth), depth, 0)[..., None]
    grey = np.choose(which, [
        _texture(place[..., 0], place[..., 2], 1), _texture(place[..., 1], place[..., 2], 2),
        _texture(place[..., 1], place[..., 2], 3), _texture(place[..., 0], place[..., 1], 4),
    ])  # fmt: skip
    sky = place[..., 1] < -ROOF_M
    return np.where(sky, 230, grey).astype(np.float32), depth, which, sky


def pose(heading_rad: float, x: float, z: float) -> np.ndarray:
    """Return T_world_cam [4,4] of a camera that looks `heading_rad` to the left of the street, at x and z in metres."""
    T = np.eye(4)
    T[0, 0] = T[2, 2] = np.cos(heading_rad)
    T[0, 2], T[2, 0] = -np.sin(heading_rad), np.sin(heading_rad)
    T[0, 3], T[2, 3] = x, z
    return T


def arc(frames: int, yaw_rate_radps: float, speed_mps: float, dt_s: float = 0.1) -> list[np.ndarray]:
    """Return the poses of a camera on a circle, or a straight line, left +."""
    poses, heading, x, z = [], -yaw_rate_radps * dt_s * frames / 2, 0.0, 0.0
    for _ in range(frames):
        poses.append(pose(heading, x, z))
        middle = heading + yaw_rate_radps * dt_s / 2
        chord = speed_mps * dt_s * np.sinc(yaw_rate_radps * dt_s / 2 / np.pi)
        x, z, heading = x - chord * np.sin(middle), z + chord * np.cos(middle), heading + yaw_rate_radps * dt_s
    return poses
