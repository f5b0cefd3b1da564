"""Routes: exact curvature of bends and of the line."""

import numpy as np
import pytest

from pipeline.sample.manoeuvres import DECK, draw_route
from pipeline.sample.route import AHEAD_M, STEP_M, Route, bend, trace


@pytest.fixture(scope="module")
def routes() -> list[Route]:
    return [draw_route(np.random.default_rng(seed), 60 + AHEAD_M, 3.5, first) for seed, first in enumerate(DECK)]


@pytest.mark.parametrize("angle_deg", [90, -90, 20, -4])
def test_a_bend_turns_by_its_angle(angle_deg: float) -> None:
    pieces = bend(np.deg2rad(angle_deg), radius_m=12.0, transition_m=8.0)
    _, _, heading, curvature = trace([*pieces, (5.0, 0.0, 0.0)])
    np.testing.assert_allclose(np.rad2deg(heading[-1]), angle_deg, atol=0.1)
    assert np.abs(curvature).max() <= 1 / 12 + 1e-9
    if abs(angle_deg) > 45:  # long enough for an arc between the clothoids
        np.testing.assert_allclose(np.abs(curvature).max(), 1 / 12)


def test_full_circle_is_closed() -> None:
    s, xy, _, _ = trace([(2 * np.pi * 20, 1 / 20, 1 / 20)])
    np.testing.assert_allclose(xy[-1], [0, 0], atol=STEP_M)
    np.testing.assert_allclose(np.linalg.norm(xy - [0, 20], axis=1), 20, atol=1e-3)
    assert s[-1] == pytest.approx(2 * np.pi * 20, abs=STEP_M)


def test_curvature_is_continuous_and_matches_the_line(routes: list[Route]) -> None:
    for route in routes:
        assert np.abs(np.diff(route.curvature_1pm)).max() < 0.006  # 1/m per 0.1 m
        steps = np.diff(route.xy, axis=0)
        turned = np.diff(np.unwrap(np.arctan2(steps[:, 1], steps[:, 0])))
        np.testing.assert_allclose(turned / STEP_M, route.curvature_1pm[1:-1], atol=2e-3)
        np.testing.assert_allclose(np.linalg.norm(steps, axis=1), STEP_M)


def test_no_road_crosses_itself(routes: list[Route]) -> None:
    for route in routes:
        s, xy = route.s_m[::20], route.xy[::20]
        apart = np.linalg.norm(xy[:, None] - xy[None], axis=-1)
        assert apart[np.abs(s[:, None] - s[None]) > 60].min() > 20
