"""Estimate the camera's motion from 3D points of the previous frame and their pixels in this one
(PnP).

RANSAC separates the static street from moving objects. It fails where most depths are wrong, but
there the previous motion is close to the solution: both are refined, and the fit with the lower
cost is the result. The refinement models two errors: that of a pixel, PIXEL_SIGMA in each
direction, and that of a point's depth, which moves its pixel along the epipolar line. So rotation
and direction of travel come from the pixels' offsets across these lines, and only the length of the
step depends on depth.
"""

from typing import NamedTuple

import cv2
import numpy as np

from pipeline.camera.geometry import rigid

MIN_POINTS = 20
# Minimum inlier ratios after RANSAC and after refinement: in a queue of cars, most points may move
# with the cars. A motion that differs by at most SIMILAR_DEG and SIMILAR_M from the previous one
# needs fewer inliers.
MIN_RANSAC_INLIERS, MIN_INLIERS, MIN_INLIERS_SIMILAR = 0.3, 0.6, 0.4
SIMILAR_DEG, SIMILAR_M = 1.0, 0.5
RANSAC_PX = 2.0  # reprojection error of an inlier
RANSAC_ITERATIONS = 100
PIXEL_SIGMA = 0.3
CAUCHY = 2.0  # residual in sigmas at which the weight is a half
ITERATIONS = 6
INLIER_SIGMAS = 3.0
MIN_DEPTH_M = 0.3  # points closer than this to the camera get no weight
BEHIND = 1e4  # squared Mahalanobis distance of points behind the camera: outliers


class Pose(NamedTuple):
    """A refined motion [4,4] and its robust cost; of N points, which are inliers and their
    reprojection errors.
    """

    T_now_before: np.ndarray
    cost: float
    inliers: np.ndarray
    error_px: np.ndarray


def estimate_pose(
    xyz: np.ndarray,
    uv: np.ndarray,
    K: np.ndarray,
    depth_sigma: np.ndarray,
    T_previous: np.ndarray | None = None,
) -> Pose | None:
    """Return the motion that maps points to their pixels; None if too few agree or they leave it
    open.

    `xyz`: MIN_POINTS or more points [N,3] in metres in the previous camera frame, with relative
    standard deviations `depth_sigma` [N] of their depths; `uv`: their pixels in this frame [N,2];
    `T_previous`: the T_now_before [4,4] of the previous step, a second initial value.
    """
    starts = [T for T in (_ransac(xyz, uv, K), T_previous) if T is not None]
    fits = [fit for T in starts if (fit := _refine(T, xyz, uv, K, depth_sigma))]
    if not fits:
        return None
    best = min(fits, key=lambda fit: fit.cost)
    similar = False
    if T_previous is not None:
        turned_rad = np.linalg.norm(
            cv2.Rodrigues(best.T_now_before[:3, :3] @ T_previous[:3, :3].T)[0]
        )
        moved_m = np.linalg.norm(best.T_now_before[:3, 3] - T_previous[:3, 3])
        similar = bool(turned_rad < np.radians(SIMILAR_DEG) and moved_m < SIMILAR_M)
    least = max(MIN_POINTS, (MIN_INLIERS_SIMILAR if similar else MIN_INLIERS) * len(xyz))
    return best if best.inliers.sum() >= least else None


def _ransac(xyz: np.ndarray, uv: np.ndarray, K: np.ndarray) -> np.ndarray | None:
    """Return the motion [4,4] of most points; None if too few agree. Same arguments as
    :func:`estimate_pose`.
    """
    success, rotation, translation, inliers = cv2.solvePnPRansac(
        xyz, uv, K, None, iterationsCount=RANSAC_ITERATIONS, reprojectionError=RANSAC_PX
    )
    if (
        not success
        or inliers is None
        or len(inliers) < max(MIN_POINTS, MIN_RANSAC_INLIERS * len(xyz))
    ):
        return None
    return rigid(cv2.Rodrigues(rotation)[0], translation[:, 0])


def _refine(
    T: np.ndarray, xyz: np.ndarray, uv: np.ndarray, K: np.ndarray, depth_sigma: np.ndarray
) -> Pose | None:
    """Return the motion of least robust cost near `T` [4,4], by Gauss-Newton steps with Cauchy's
    weights.

    None if the points do not constrain it: all behind the camera, or all at one place.
    """
    T = T.copy()
    for _ in range(ITERATIONS):
        error, weight, squared_distance, jacobian = _linearise(T, xyz, uv, K, depth_sigma)
        robust = weight / (1 + squared_distance / CAUCHY**2)[:, None, None]
        weighted = np.einsum("nia,nij->naj", jacobian, robust)
        normal, gradient = (
            np.einsum("naj,njb->ab", weighted, jacobian),
            np.einsum("naj,nj->a", weighted, error),
        )
        try:
            change = -np.linalg.solve(normal, gradient)
        except np.linalg.LinAlgError:
            return None
        T[:3, :3] = cv2.Rodrigues(change[:3])[0] @ T[:3, :3]
        T[:3, 3] += change[3:]
    error, _, squared_distance, _ = _linearise(T, xyz, uv, K, depth_sigma)
    cost = float(np.log1p(squared_distance / CAUCHY**2).sum())
    return Pose(T, cost, squared_distance < INLIER_SIGMAS**2, np.linalg.norm(error, axis=-1))


def _linearise(
    T: np.ndarray, xyz: np.ndarray, uv: np.ndarray, K: np.ndarray, depth_sigma: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return errors [N,2] px, inverse covariances, squared distances [N], Jacobians [N,2,6] by turn
    and translation.
    """
    rotated = xyz @ T[:3, :3].T
    x, y, z = (rotated + T[:3, 3]).T
    behind = z < MIN_DEPTH_M
    z = np.where(behind, MIN_DEPTH_M, z)
    fx, fy = K[0, 0], K[1, 1]
    error = np.stack([fx * x / z + K[0, 2], fy * y / z + K[1, 2]], axis=-1) - uv
    zero = np.zeros_like(z)
    by_point = np.stack(
        [fx / z, zero, -fx * x / z**2, zero, fy / z, -fy * y / z**2], axis=-1
    ).reshape(-1, 2, 3)
    a, b, c = rotated.T
    by_rotation = np.stack([zero, c, -b, -c, zero, a, b, -a, zero], axis=-1).reshape(-1, 3, 3)
    per_sigma = depth_sigma[:, None] * np.einsum("nij,nj->ni", by_point, rotated)  # px
    # The inverse of PIXEL_SIGMA² I + per_sigma per_sigmaᵀ, by Sherman and Morrison.
    total = PIXEL_SIGMA**2 + (per_sigma**2).sum(axis=1)
    shrink = per_sigma[:, :, None] * per_sigma[:, None, :] / total[:, None, None]
    weight = (np.eye(2) - shrink) / PIXEL_SIGMA**2
    weight[behind] = 0
    squared_distance = np.where(behind, BEHIND, np.einsum("ni,nij,nj->n", error, weight, error))
    return (
        error,
        weight,
        squared_distance,
        np.concatenate([by_point @ by_rotation, by_point], axis=-1),
    )
