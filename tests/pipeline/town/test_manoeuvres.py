"""Drawn roads: first manoeuvre, turns to both sides, no crossing of themselves, closed side roads."""

import numpy as np
import pytest

from pipeline.town.manoeuvres import DECK, draw_route
from pipeline.town.route import AHEAD_M, Route

LENGTH_M = 50.0


@pytest.fixture(scope="module")
def routes() -> list[tuple[str, Route]]:
    return [
        (first, draw_route(np.random.default_rng([seed, i]), LENGTH_M + AHEAD_M, lane_m, first))
        for i, first in enumerate(DECK)
        for seed, lane_m in enumerate((2.0, 3.3))
    ]


def test_no_road_crosses_itself(routes: list[tuple[str, Route]]) -> None:
    for _, route in routes:
        s, xy = route.s_m[::20], route.xy[::20]
        apart = np.linalg.norm(xy[:, None] - xy[None], axis=-1)
        assert apart[np.abs(s[:, None] - s[None]) > 60].min() > 20


def test_side_roads_are_closed_where_the_car_turns(routes: list[tuple[str, Route]]) -> None:
    closed_at_turns = []
    for _, route in routes:
        for arm in route.arms:
            s = route.s_m[np.argmin(np.linalg.norm(route.at(route.s_m, route.centre_m)[0] - arm.xy, axis=1))]
            if np.abs(route.curvature_1pm[np.abs(route.s_m - s) < 4]).max() > 0.05:
                closed_at_turns.append(arm.closed)
            else:
                assert not arm.closed  # straight on, past side roads
    assert len(closed_at_turns) > 5
    assert all(closed_at_turns)
