"""Estimate the camera's motion from 3D points of the previous frame and their pixels (PnP).

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

# Least number of points, and of inliers.
MIN_POINTS = 20
# Least share of inliers of RANSAC.
MIN_RANSAC_INLIERS = 0.3
# Least share of inliers after the refinement: in a queue of cars, most points may move with the
# cars.
MIN_INLIERS = 0.6
# Least share of inliers after the refinement of a motion that is similar to the previous one. With
# MIN_INLIERS for every motion, 4.1 % of the frames of Udacity's drive, whose narrow view shows
# little of the road, could not be measured, and with this 0.8 %, but a lorry's motion was taken for
# the car's.
MIN_INLIERS_SIMILAR = 0.4
# Largest rotation in degrees between similar motions.
SIMILAR_DEG = 1.0
# Largest difference in metres between similar motions.
SIMILAR_M = 0.5

# Largest reprojection error in pixels of an inlier of RANSAC.
RANSAC_PX = 2.0
RANSAC_ITERATIONS = 100
# Standard deviation in pixels of a tracked corner, in each direction.
PIXEL_SIGMA = 0.3
# Error in standard deviations at which a point has half of its weight.
CAUCHY = 2.0
# Number of Gauss-Newton steps of the refinement.
ITERATIONS = 6
# Largest error in standard deviations of an inlier of the refinement.
INLIER_SIGMAS = 3.0
# Distance in metres from the camera below which points get no weight.
MIN_DEPTH_M = 0.3
# Squared Mahalanobis distance of these points, that of an outlier.
BEHIND = 1e4


class Matches(NamedTuple):
    """N points of the previous frame, and the pixels in which this frame shows them."""

    xyz: np.ndarray  # [N,3] in metres, in the previous camera's frame
    depth_sigma: np.ndarray  # relative standard deviations of their depths [N]
    uv: np.ndarray  # pixels [N,2]


class Pose(NamedTuple):
    """A refined motion, its robust cost, and which of N points agree with it."""

    T_now_before: np.ndarray  # [4,4]
    cost: float
    inliers: np.ndarray  # bool [N]


class _Linearised(NamedTuple):
    """The errors of N points near a motion."""

    error_px: np.ndarray  # [N,2]
    weight: np.ndarray  # inverse covariances of the errors [N,2,2]; 0 behind the camera
    squared_distance: np.ndarray  # squared Mahalanobis distances of the errors [N]
    jacobian: np.ndarray  # of the errors by rotation and translation [N,2,6]


def estimate_pose(
    matches: Matches, K: np.ndarray, T_previous: np.ndarray | None = None
) -> Pose | None:
    """Return the motion that maps points to their pixels; None if too few agree with it.

    Also None if the MIN_POINTS or more `matches` do not constrain it. `T_previous`: the
    T_now_before [4,4] of the previous step, a second initial value.
    """
    best: Pose | None = None
    for T_start in (_find_by_ransac(matches, K), T_previous):
        if T_start is None:
            continue
        fit = _refine_motion(T_start, matches, K)
        if fit and (best is None or fit.cost < best.cost):
            best = fit
    if best is None:
        return None

    least = MIN_INLIERS
    if T_previous is not None and _is_similar(best.T_now_before, T_previous):
        least = MIN_INLIERS_SIMILAR
    if best.inliers.sum() < max(MIN_POINTS, least * len(matches.uv)):
        return None
    return best


def _is_similar(T: np.ndarray, T_previous: np.ndarray) -> bool:
    """Return whether two motions [4,4] differ by at most SIMILAR_DEG and SIMILAR_M."""
    turned_rad = np.linalg.norm(cv2.Rodrigues(T[:3, :3] @ T_previous[:3, :3].T)[0])
    moved_m = np.linalg.norm(T[:3, 3] - T_previous[:3, 3])
    return bool(turned_rad < np.radians(SIMILAR_DEG) and moved_m < SIMILAR_M)


def _find_by_ransac(matches: Matches, K: np.ndarray) -> np.ndarray | None:
    """Return the motion [4,4] of most points; None if too few agree."""
    success, rotation, translation, inliers = cv2.solvePnPRansac(
        matches.xyz,
        matches.uv,
        K,
        None,
        iterationsCount=RANSAC_ITERATIONS,
        reprojectionError=RANSAC_PX,
    )
    if not success or inliers is None:
        return None
    if len(inliers) < max(MIN_POINTS, MIN_RANSAC_INLIERS * len(matches.uv)):
        return None
    return rigid(cv2.Rodrigues(rotation)[0], translation[:, 0])


def _refine_motion(T: np.ndarray, matches: Matches, K: np.ndarray) -> Pose | None:
    """Return the motion of least robust cost near `T` [4,4], by Gauss-Newton with Cauchy's weights.

    None if the points do not constrain it: all behind the camera, or all at one place.
    """
    T = T.copy()
    for _ in range(ITERATIONS):
        points = _linearise_errors(T, matches, K)
        robust = points.weight / (1 + points.squared_distance / CAUCHY**2)[:, None, None]

        # The normal equations: (Σ JᵀWJ) change = −Σ JᵀW error.
        weighted = np.einsum("nia,nij->naj", points.jacobian, robust)
        normal = np.einsum("naj,njb->ab", weighted, points.jacobian)
        gradient = np.einsum("naj,nj->a", weighted, points.error_px)
        try:
            change = -np.linalg.solve(normal, gradient)
        except np.linalg.LinAlgError:
            return None

        T[:3, :3] = cv2.Rodrigues(change[:3])[0] @ T[:3, :3]
        T[:3, 3] += change[3:]

    points = _linearise_errors(T, matches, K)
    cost = float(np.log1p(points.squared_distance / CAUCHY**2).sum())
    return Pose(T, cost, inliers=points.squared_distance < INLIER_SIGMAS**2)


def _linearise_errors(T: np.ndarray, matches: Matches, K: np.ndarray) -> _Linearised:
    """Return the points' errors at the motion `T` [4,4], and their derivatives by the motion."""
    rotated = matches.xyz @ T[:3, :3].T
    x, y, z = (rotated + T[:3, 3]).T
    behind = z < MIN_DEPTH_M
    z = np.where(behind, MIN_DEPTH_M, z)

    fx = K[0, 0]
    fy = K[1, 1]
    error_px = np.stack([fx * x / z + K[0, 2], fy * y / z + K[1, 2]], axis=-1)
    error_px -= matches.uv

    # By the point: rows for u and v, columns for x, y and z.
    zero = np.zeros_like(z)
    by_point = np.stack([fx / z, zero, -fx * x / z**2, zero, fy / z, -fy * y / z**2], axis=-1)
    by_point = by_point.reshape(-1, 2, 3)

    # By a small rotation before the translation: minus the cross product's matrix of the point.
    a, b, c = rotated.T
    by_rotation = np.stack([zero, c, -b, -c, zero, a, b, -a, zero], axis=-1).reshape(-1, 3, 3)
    jacobian = np.concatenate([by_point @ by_rotation, by_point], axis=-1)

    # The covariance of a pixel is PIXEL_SIGMA² I + px_per_sigma px_per_sigmaᵀ: an error of depth
    # moves a point along its ray. The inverse is that of Sherman and Morrison.
    px_per_sigma = matches.depth_sigma[:, None] * np.einsum("nij,nj->ni", by_point, rotated)
    total = PIXEL_SIGMA**2 + (px_per_sigma**2).sum(axis=1)
    shrink = px_per_sigma[:, :, None] * px_per_sigma[:, None, :] / total[:, None, None]
    weight = (np.eye(2) - shrink) / PIXEL_SIGMA**2
    weight[behind] = 0

    squared_distance = np.einsum("ni,nij,nj->n", error_px, weight, error_px)
    squared_distance = np.where(behind, BEHIND, squared_distance)
    return _Linearised(error_px, weight, squared_distance, jacobian)
