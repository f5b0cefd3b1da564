"""Project and back-project with a pinhole camera (paper eq. 6), and apply rigid transforms.

The frame of a rectified camera is x right, y down, z forward. The velodyne frame is x forward, y
left, z up. ``T_a_b`` transforms points from frame b to frame a. A pixel (u, v) is (column, row).
Integer coordinates are pixel centres, as in KITTI's calibration.
"""

import numpy as np
from numpy.typing import ArrayLike

# Height of the scanner in metres above flat ground, according to KITTI's setup page. The sample has
# the same height.
SCANNER_HEIGHT_M = 1.73
# Height in metres above flat ground of a camera without a known height. It is that of KITTI's
# cameras, according to the same page.
CAMERA_HEIGHT_M = 1.65


def camera_rays(K: np.ndarray, size: tuple[int, ...]) -> np.ndarray:
    """Return K⁻¹[u,v,1]ᵀ for each pixel of an image, float64 [H,W,3].

    This is the direction of the pixel, of which the third component is 1. `size` is (H, W).
    """
    v, u = np.mgrid[: size[0], : size[1]].astype(np.float64)
    homogeneous = np.stack([u, v, np.ones_like(u)], axis=-1)
    return homogeneous @ np.linalg.inv(K).T


def back_project(depth_m: np.ndarray, K: np.ndarray) -> np.ndarray:
    """Return the camera-frame point of each pixel, [H,W,3] metres (paper eq. 6).

    `depth_m` [H,W] is the distance along the optical axis (z), in metres.

    >>> K = np.array([[2.0, 0, 1], [0, 2, 0], [0, 0, 1]])  # focal length 2, principal point (1, 0)
    >>> back_project(np.array([[4.0, 4.0, 8.0]]), K).tolist()
    [[[-2.0, 0.0, 4.0], [0.0, 0.0, 4.0], [4.0, 0.0, 8.0]]]
    """
    return depth_m[..., None] * camera_rays(K, depth_m.shape)


def project(xyz: np.ndarray, K: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return pixels (u, v) [N,2] and depths z [N] of camera-frame points [N,3].

    The pixels of points with z ≤ 0 are NaN.
    """
    homogeneous = xyz @ K.T
    z = homogeneous[:, 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        uv = np.where(z[:, None] > 0, homogeneous[:, :2] / z[:, None], np.nan)
    return uv, z


def pixels_of(
    xyz: np.ndarray, K: np.ndarray, size: tuple[int, ...]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the points inside of an image: their indices [M], and their pixels' rows and columns.

    `xyz` [N,3] holds the points in the camera frame. `size` is (H, W).
    """
    uv, _ = project(xyz, K)
    nearest = np.rint(uv)
    in_image = (nearest >= 0) & (nearest < size[::-1])  # NaN compares as False
    index = np.flatnonzero(in_image.all(axis=1))
    column, row = nearest[index].astype(np.int64).T
    return index, row, column


def rigid(R: np.ndarray, t: ArrayLike) -> np.ndarray:
    """Return the transform [4,4] with rotation `R` [3,3] and translation `t` [3]."""
    T = np.eye(4)
    T[:3, :3] = R
    T[:3, 3] = t
    return T


def transform(T: np.ndarray, xyz: np.ndarray) -> np.ndarray:
    """Apply the rigid transform `T` [4,4] to points [N,3]."""
    return xyz @ T[:3, :3].T + T[:3, 3]


def depth_image(xyz: np.ndarray, K: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Return the depth [H,W] in metres of the nearest point in each pixel, 0 where there is none.

    `xyz` [N,3] holds the points in the camera frame. KITTI's depth benchmark makes sparse depth
    from scans in this way.
    """
    index, row, column = pixels_of(xyz, K, size)
    depth_m = np.full(size, np.inf)
    np.minimum.at(depth_m, (row, column), xyz[index, 2])
    return np.where(np.isinf(depth_m), 0.0, depth_m)
