"""Drawn roads: first manoeuvre, turns to both sides, no crossing of themselves, closed side roads."""

import numpy as np
import pytest

from pipeline.town.manoeuvres import DECK, draw_route
from pipeline.town.route import AHEAD_M, BEHIND_M, Route

LENGTH_M = 50.0


@pytest.fixture(scope="module")
def routes() -> list[tuple[str, Route]]:
    return [
        (first, draw_route(np.random.default_rng([seed, i]), LENGTH_M + AHEAD_M, lane_m, first))
        for i, first in enumerate(DECK)
        for seed, lane_m in enumerate((2.0, 3.3))
    ]


def test_a_road_reaches_from_behind_the_first_frame_to_beyond_the_last(routes: list[tuple[str, Route]]) -> None:
    for _, route in routes:
        assert route.s_m[0] == pytest.approx(-BEHIND_M, abs=1e-6)
        assert route.s_m[-1] == pytest.approx(LENGTH_M + AHEAD_M, abs=0.2)
        assert np.abs(route.s_m).min() < 1e-6  # the first frame is one of the samples


def test_a_drive_begins_with_its_manoeuvre_often_amid_it(routes: list[tuple[str, Route]]) -> None:
    amid = 0
    for first, route in routes:
        start = route.curvature_1pm[(route.s_m >= 0) & (route.s_m < 14)]
        bent = start[start != 0]
        if first != "crossing":
            assert (bent[0] < 0) == (first == "right" or first.endswith("-"))
        amid += start[0] != 0
    assert len(routes) / 4 < amid < len(routes)


def test_crossings_are_tight_right_ones_tighter(routes: list[tuple[str, Route]]) -> None:
    total = np.concatenate([route.curvature_1pm for _, route in routes])
    sharpest_right, sharpest_left = np.arctan(2.7 * -total.min()), np.arctan(2.7 * total.max())
    assert 0.45 < sharpest_right < 0.5
    assert 0.4 < sharpest_left < sharpest_right
    assert abs(np.sum(total)) < 0.35 * np.sum(np.abs(total))


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


def test_same_seed_same_road() -> None:
    first, again = (draw_route(np.random.default_rng(5), 100.0, 3.0, "left") for _ in range(2))
    np.testing.assert_array_equal(first.xy, again.xy)
    assert [arm.heading_rad for arm in first.arms] == [arm.heading_rad for arm in again.arms]
