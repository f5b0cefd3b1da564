"""Pose estimation with outliers, and with points that do not constrain the pose."""

import numpy as np
import pytest

from pipeline.camera.geometry import project, transform
from pipeline.motion.pose import estimate_pose
from tests import street
from tests.street import pose

K = street.WIDE.K

POINTS = 60


def street(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Return pixels [N,2] and their points [N,3], 3 to 60 m ahead."""
    uv = rng.uniform([0, 0], [320, 96], (POINTS, 2))
    z = rng.uniform(3, 60, POINTS)
    return uv, np.column_stack([(uv - K[:2, 2]) / np.diag(K)[:2] * z[:, None], z])


def test_outliers_do_not_change_the_pose() -> None:
    uv, xyz = street(np.random.default_rng(0))
    uv[:15] += 30.0
    found = estimate_pose(xyz, uv, K, np.full(POINTS, 0.1))
    assert found
    assert found.inliers.tolist() == [False] * 15 + [True] * (POINTS - 15)
    np.testing.assert_allclose(found.T_now_before, np.eye(4), atol=1e-3)


@pytest.mark.parametrize("seed", range(5))
def test_no_pose_from_degenerate_points(seed: int) -> None:
    rng = np.random.default_rng(seed)
    uv, xyz = street(rng)
    sigma = np.full(POINTS, 0.5)
    coincident = np.tile(xyz[:1], (POINTS, 1)) + rng.normal(0, 1e-6, (POINTS, 3))
    assert estimate_pose(coincident, np.tile(uv[:1], (POINTS, 1)) + rng.normal(0, 0.3, uv.shape), K, sigma) is None
    xyz[:, 1] = 1.65
    assert estimate_pose(xyz, rng.uniform(0, 96, (POINTS, 2)), K, sigma) is None


def test_half_of_the_points_are_enough_only_for_a_motion_like_the_previous_one() -> None:
    _, xyz = street(np.random.default_rng(0))
    forth, lorry = np.linalg.inv(pose(0, 0, 1.0)), np.linalg.inv(pose(0.1, 0.5, -1.0))
    static = np.arange(POINTS) % 20 < 11
    uv = np.where(static[:, None], project(transform(forth, xyz), K)[0], project(transform(lorry, xyz), K)[0])
    sigma = np.full(POINTS, 0.1)
    assert estimate_pose(xyz, uv, K, sigma) is None
    assert estimate_pose(xyz, uv, K, sigma, np.linalg.inv(pose(0, 0, 3.0))) is None
    found = estimate_pose(xyz, uv, K, sigma, np.linalg.inv(pose(0, 0, 1.2)))
    assert found
    np.testing.assert_allclose(found.T_now_before, forth, atol=0.01)


@pytest.mark.parametrize("seed", [21, 23, 39])
def test_points_behind_the_camera_are_outliers(seed: int) -> None:
    """Otherwise, from so wrong a start, a motion past most points would fit best."""
    rng = np.random.default_rng(seed)
    uv, xyz = street(rng)
    near = xyz * (rng.uniform(1, 8, POINTS) / xyz[:, 2])[:, None]
    uv[:12] += 30.0
    found = estimate_pose(near, uv, K, np.full(POINTS, 0.5), np.linalg.inv(pose(0, 0, 7.0)))
    assert found
    np.testing.assert_allclose(found.T_now_before, np.eye(4), atol=0.05)


@pytest.mark.parametrize("seed", range(4))
def test_the_last_motion_is_a_start_where_most_depths_are_wrong(seed: int) -> None:
    rng = np.random.default_rng(seed)
    xyz = 0.3 * street(rng)[1]
    forth = np.linalg.inv(pose(0.05, 0, 0.67))
    known = np.arange(POINTS) < 8
    wrong = np.where(known, 1, np.exp(rng.normal(0, 1, POINTS)))[:, None] * xyz
    uv, sigma = project(transform(forth, xyz), K)[0], np.where(known, 0.02, 1.0)
    errors = []
    for T_last in None, np.linalg.inv(pose(0.04, 0, 0.6)):
        found = estimate_pose(wrong, uv, K, sigma, T_last)
        assert found
        errors.append(np.abs(found.T_now_before - forth).max())
    assert errors[1] < 0.004
    assert errors[1] < errors[0] / 3
