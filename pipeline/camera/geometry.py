"""Project and back-project with a pinhole camera (paper eq. 6), and apply rigid transforms.

Frames: camera = rectified, x right, y down, z forward; velodyne = x forward, y left, z up. ``T_a_b`` takes points from
frame b to frame a. Pixel (u, v) = (column, row); integer coordinates are pixel centres, as in KITTI's calibration.
"""

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from pipeline.camera.camera import Camera


def rays(K: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Return K⁻¹[u,v,1]ᵀ for each pixel, float64 [H,W,3]; the third component is 1."""
    v, u = np.mgrid[: size[0], : size[1]].astype(np.float64)
    return np.stack([u, v, np.ones_like(u)], axis=-1) @ np.linalg.inv(K).T


def back_project(depth_m: np.ndarray, K: np.ndarray) -> np.ndarray:
    """Return the camera-frame point of each pixel, [H,W,3] metres (paper eq. 6).

    `depth_m` [H,W] is the distance along the optical axis (z), in metres.
    """
    return depth_m[..., None] * rays(K, (depth_m.shape[0], depth_m.shape[1]))


def project(xyz: np.ndarray, K: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return pixels (u, v) [N,2] and depths z [N] of camera-frame points [N,3]. Points with z ≤ 0 get NaN pixels."""
    homogeneous = xyz @ K.T
    z = homogeneous[:, 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        uv = np.where(z[:, None] > 0, homogeneous[:, :2] / z[:, None], np.nan)
    return uv, z


def transform(T: np.ndarray, xyz: np.ndarray) -> np.ndarray:
    """Apply the rigid transform `T` [4,4] to points [N,3]."""
    return xyz @ T[:3, :3].T + T[:3, 3]


def depth_image(xyz: np.ndarray, K: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Return the depth [H,W] in metres of the nearest point in each pixel, 0 where there is none.

    `xyz` [N,3] in the camera frame. KITTI's depth benchmark makes sparse depth from scans in this way.
    """
    uv, z = project(xyz, K)
    front = z > 0
    pixel = np.rint(uv[front]).astype(np.int64)
    z = z[front]
    inside = (pixel >= 0).all(axis=1) & (pixel[:, 0] < size[1]) & (pixel[:, 1] < size[0])
    pixel, z = pixel[inside], z[inside]
    depth = np.full(size, np.inf)
    np.minimum.at(depth, (pixel[:, 1], pixel[:, 0]), z)
    return np.where(np.isinf(depth), 0.0, depth)


def scan_depth(scan: np.ndarray, camera: "Camera") -> np.ndarray:
    """Return the :func:`depth_image` float32 [H,W] of a LiDAR scan [P,≥3] that begins with velodyne x, y, z."""
    assert camera.T_cam_velo is not None
    xyz = transform(camera.T_cam_velo, scan[:, :3].astype(np.float64))
    return depth_image(xyz, camera.K, camera.size).astype(np.float32)
