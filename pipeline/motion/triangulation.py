"""Compare the lengths of successive steps by points that are seen in three frames.

A point's depth in step lengths follows from its pixels before and after a step. A point in the
middle of three frames has two such depths, and their quotient is that of the two lengths. Depth of
an encoder has no part in it.
"""

from typing import NamedTuple

import numpy as np

from pipeline.camera.geometry import project
from pipeline.motion.step import MEDIAN_DEVIATION

# Least parallax in pixels of a point that is compared.
MIN_PARALLAX_PX = 0.5
# Least number of points that are compared.
MIN_TRIPLES = 20
# Largest distance in pixels of a point in the third frame from where its triangulation puts it.
MAX_ERROR_PX = 1.0
# Standard deviation of the logarithm of a ratio of lengths, apart from the scatter of its points:
# on KITTI drives 0005, 0039 and 0042, ratios differ from the recorded ones by 0.006 to 0.009.
RATIO_NOISE = 0.006
# Factor on the standard error of the median of points, since points near each other err alike. With
# it and RATIO_NOISE, errors on the three drives and on eight of the sample are as large as stated.
POINTS_ALIKE = 2.0


class Tracks(NamedTuple):
    """The N points of a step, as they are seen in the frame at its end."""

    uv: np.ndarray  # pixels [N,2]
    depth_steps: np.ndarray  # depths [N] in lengths of the step
    parallax_px: np.ndarray  # parallaxes [N] by the step


class Ratio(NamedTuple):
    """The length of a step relative to that of the step before; 0 if it is unknown."""

    value: float = 0.0
    sigma: float = 0.0  # standard deviation of its logarithm


class _Triangulated(NamedTuple):
    """N points, seen from both ends of a step."""

    before: np.ndarray  # depths [N] in the frame before, in lengths of the step
    now: np.ndarray  # depths [N] in the frame now
    parallax_px: np.ndarray  # [N]
    has_parallax: np.ndarray  # bool [N]: in front of both cameras, with enough parallax


def pixel_rays(uv: np.ndarray, K: np.ndarray) -> np.ndarray:
    """Return K⁻¹[u,v,1]ᵀ for pixels (u, v) [N,2], float64 [N,3]."""
    return np.linalg.solve(K, np.column_stack([uv, np.ones(len(uv))]).T).T


def find_tracks(
    uv_before: np.ndarray, uv: np.ndarray, T_before_now: np.ndarray, K: np.ndarray
) -> Tracks:
    """Return the usable points among pixels [N,2] before and after a step [4,4]."""
    points = _triangulate_points(uv_before, uv, T_before_now, K)
    use = points.has_parallax
    return Tracks(uv[use], points.now[use], points.parallax_px[use])


def compare_lengths(
    tracks: Tracks, uv: np.ndarray, T_before_now: np.ndarray, K: np.ndarray
) -> Ratio:
    """Return the length of a step relative to that of the step before.

    `tracks`: N points of the step before; `uv`: their pixels [N,2] after this step [4,4].
    """
    points = _triangulate_points(tracks.uv, uv, T_before_now, K)
    use = points.has_parallax & (
        _measure_errors(points, tracks.uv, uv, T_before_now, K) < MAX_ERROR_PX
    )
    if use.sum() < MIN_TRIPLES:
        return Ratio()

    # A depth is the less certain, the smaller the parallax.
    log_ratios = np.log(tracks.depth_steps[use] / points.before[use])
    weight = 1 / (tracks.parallax_px[use] ** -2 + points.parallax_px[use] ** -2)
    middle = _weighted_median(log_ratios, weight)
    deviation = _weighted_median(np.abs(log_ratios - middle), weight) / MEDIAN_DEVIATION
    standard_error = deviation * np.sqrt((weight**2).sum()) / weight.sum()
    return Ratio(float(np.exp(middle)), float(np.hypot(RATIO_NOISE, POINTS_ALIKE * standard_error)))


def _triangulate_points(
    uv_before: np.ndarray, uv: np.ndarray, T_before_now: np.ndarray, K: np.ndarray
) -> _Triangulated:
    """Return where the rays of pixels [N,2] before and now are nearest to each other."""
    rotation = T_before_now[:3, :3]
    direction = T_before_now[:3, 3] / np.linalg.norm(T_before_now[:3, 3])
    a = pixel_rays(uv_before, K)
    b = pixel_rays(uv, K) @ rotation.T

    # before · a − now · b = direction, by least squares.
    aa = (a * a).sum(axis=1)
    bb = (b * b).sum(axis=1)
    ab = (a * b).sum(axis=1)
    determinant = np.maximum(aa * bb - ab**2, np.finfo(float).tiny)
    before = (bb * (a @ direction) - ab * (b @ direction)) / determinant
    now = (ab * (a @ direction) - aa * (b @ direction)) / determinant

    sine = np.sqrt(determinant / (aa * bb))
    parallax_px = sine * K[0, 0]
    has_parallax = (before > 0) & (now > 0) & (parallax_px > MIN_PARALLAX_PX)
    return _Triangulated(before, now, parallax_px, has_parallax)


def _measure_errors(
    points: _Triangulated, uv_before: np.ndarray, uv: np.ndarray, T: np.ndarray, K: np.ndarray
) -> np.ndarray:
    """Return the distances [N] in pixels of points from where they are seen now.

    They are NaN for points behind the camera.
    """
    direction = T[:3, 3] / np.linalg.norm(T[:3, 3])
    xyz_before = pixel_rays(uv_before, K) * points.before[:, None]
    xyz_now = (xyz_before - direction) @ T[:3, :3]
    projected, _ = project(xyz_now, K)
    return np.linalg.norm(projected - uv, axis=1)


def _weighted_median(values: np.ndarray, weight: np.ndarray) -> float:
    order = np.argsort(values)
    cumulative = np.cumsum(weight[order])
    return float(values[order][np.searchsorted(cumulative, cumulative[-1] / 2)])
