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
