"""The camera's motion from points of the frame before and where this frame shows them (perspective n points).

RANSAC finds who moves with the street. The refinement knows what is uncertain: a pixel, by PIXEL_SIGMA all
around, and a point's depth, which shifts its pixel along an epipolar line. So rotation and direction of travel come
from where pixels lie across these lines, whatever depth says, and only the way's length comes from depth.
"""

from typing import NamedTuple

import numpy as np

MIN_POINTS = 20
MIN_START, MIN_SHARE = 0.3, 0.6  # of who agrees with RANSAC's pose, and in the end: what moves in a queue is no street
RANSAC_PX = 2.0  # error of who agrees
TRIALS = 100
PIXEL_SIGMA = 0.3
CAUCHY = 2.0  # sigmas at which a residual's weight is a half
ITERATIONS = 6
GATE = 3.0  # sigmas, of an inlier
NEAR_M = 0.3  # nothing is closer to the camera


class Pose(NamedTuple):
    """Where points of the frame before are seen from now, who agrees with it, and their median error."""

    T_now_before: np.ndarray  # [4,4]
    inliers: np.ndarray  # bool [N]
    residual_px: float


def pose(xyz: np.ndarray, uv: np.ndarray, K: np.ndarray, depth_sigma: np.ndarray) -> Pose | None:
    """Return the motion that explains where points are seen; None if too few agree, or they do not tell.

    Args:
        xyz: points [N,3] in m, in the camera frame before.
        uv: where they are seen now, pixels [N,2].
        K: intrinsics [3,3].
        depth_sigma: of each point's depth, as a share of it [N].
    """
    import cv2

    if len(xyz) < MIN_POINTS:
        return None
    ok, turn, shift, agree = cv2.solvePnPRansac(xyz, uv, K, None, iterationsCount=TRIALS, reprojectionError=RANSAC_PX)
    if not ok or agree is None or len(agree) < max(MIN_POINTS, MIN_START * len(xyz)):
        return None
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = cv2.Rodrigues(turn)[0], shift[:, 0]
    for _ in range(ITERATIONS):
        error, weight, slopes = _linearised(T, xyz, uv, K, depth_sigma)
        robust = weight / (1 + _squared(error, weight) / CAUCHY**2)[:, None, None]
        weighted = np.einsum("nia,nij->naj", slopes, robust)
        normal, gradient = np.einsum("naj,njb->ab", weighted, slopes), np.einsum("naj,nj->a", weighted, error)
        try:
            change = -np.linalg.solve(normal, gradient)
        except np.linalg.LinAlgError:  # all behind the camera, or all in one place
            return None
        T[:3, :3] = cv2.Rodrigues(change[:3])[0] @ T[:3, :3]
        T[:3, 3] += change[3:]
    error, weight, _ = _linearised(T, xyz, uv, K, depth_sigma)
    inliers = _squared(error, weight) < GATE**2
    if inliers.sum() < max(MIN_POINTS, MIN_SHARE * len(xyz)):
        return None
    return Pose(T, inliers, float(np.median(np.linalg.norm(error[inliers], axis=-1))))


def _squared(error: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Return Mahalanobis' distances squared [N] of errors [N,2] with inverse covariances [N,2,2]."""
    return np.einsum("ni,nij,nj->n", error, weight, error)


def _linearised(
    T: np.ndarray, xyz: np.ndarray, uv: np.ndarray, K: np.ndarray, depth_sigma: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return errors [N,2] px, their inverse covariances [N,2,2] and derivatives [N,2,6] by rotation and translation."""
    turned = xyz @ T[:3, :3].T
    x, y, z = (turned + T[:3, 3]).T
    behind = z < NEAR_M
    z = np.where(behind, NEAR_M, z)
    fx, fy = K[0, 0], K[1, 1]
    error = np.stack([fx * x / z + K[0, 2], fy * y / z + K[1, 2]], axis=-1) - uv
    zero = np.zeros_like(z)
    by_point = np.stack([fx / z, zero, -fx * x / z**2, zero, fy / z, -fy * y / z**2], axis=-1).reshape(-1, 2, 3)
    a, b, c = turned.T
    by_turn = np.stack([zero, c, -b, -c, zero, a, b, -a, zero], axis=-1).reshape(-1, 3, 3)
    along = depth_sigma[:, None] * np.einsum("nij,nj->ni", by_point, turned)  # px per sigma of depth
    # The inverse of PIXEL_SIGMA² I + along alongᵀ, by Sherman and Morrison.
    shrink = along[:, :, None] * along[:, None, :] / (PIXEL_SIGMA**2 + (along**2).sum(axis=1))[:, None, None]
    weight = (np.eye(2) - shrink) / PIXEL_SIGMA**2
    weight[behind] = 0
    return error, weight, np.concatenate([by_point @ by_turn, by_point], axis=-1)
