"""Points that do not tell a pose give none, and no exception."""

import numpy as np
import pytest

from pipeline.motion.pose import pose
from tests.rendered_street import K

POINTS = 60


def street(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Return where points [N,2] are seen and the points themselves [N,3], 3 to 60 m ahead."""
    uv = rng.uniform([0, 0], [320, 96], (POINTS, 2))
    z = rng.uniform(3, 60, POINTS)
    return uv, np.column_stack([(uv - K[:2, 2]) / np.diag(K)[:2] * z[:, None], z])


def test_the_pose_is_that_of_who_agrees() -> None:
    uv, xyz = street(np.random.default_rng(0))
    uv[:15] += 30.0
    found = pose(xyz, uv, K, np.full(POINTS, 0.1))
    assert found
    assert found.inliers.tolist() == [False] * 15 + [True] * (POINTS - 15)
    np.testing.assert_allclose(found.T_now_before, np.eye(4), atol=1e-3)


def test_where_much_moves_by_itself_nobody_says_what_is_the_street() -> None:
    uv, xyz = street(np.random.default_rng(0))
    uv[: POINTS * 45 // 100, 0] += 30.0  # as one: a queue that no class tells
    assert pose(xyz, uv, K, np.full(POINTS, 0.1)) is None


@pytest.mark.parametrize("seed", range(20))
def test_points_in_one_place_and_on_one_line_tell_nothing(seed: int) -> None:
    rng = np.random.default_rng(seed)
    uv, xyz = street(rng)
    sigma = np.full(POINTS, 0.5)
    heap = np.tile(xyz[:1], (POINTS, 1)) + rng.normal(0, 1e-6, (POINTS, 3))
    assert pose(heap, np.tile(uv[:1], (POINTS, 1)) + rng.normal(0, 0.3, uv.shape), K, sigma) is None
    xyz[:, 1] = 1.65
    assert pose(xyz, rng.uniform(0, 96, (POINTS, 2)), K, sigma) is None
