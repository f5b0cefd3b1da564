"""The ego's motion and its oxts packets are consistent."""

import numpy as np
import pytest

from pipeline.kitti.oxts import COLUMNS
from pipeline.labels.label import steering_angle
from pipeline.sample.manoeuvres import draw_route
from pipeline.sample.motion import (
    Body,
    Journey,
    Travel,
    draw_body,
    drive,
    frame_times,
    speed_profile,
)
from pipeline.sample.oxts import RATES_LATE_S, oxts_rows
from pipeline.sample.route import AHEAD_M, Route

LAT, LON, LATERAL = 49.0, 8.4, 3.0


Drive = tuple[Route, Travel, Body, dict[str, np.ndarray]]


@pytest.fixture(scope="module", params=[1, 3])
def driven(request: pytest.FixtureRequest) -> Drive:
    rng = np.random.default_rng(request.param)
    times = frame_times(rng, 200)
    route = draw_route(rng, 9.0 * times[-1] + AHEAD_M, 3.5, "left")
    stops = (40.0,) if request.param == 3 else ()
    motion = drive(route, speed_profile(route, 9.0, LATERAL, stops), times, 2.0)
    body = draw_body(route, motion, rng)
    rows = oxts_rows(Journey(route, motion, motion, body), LAT, LON)
    assert rows.shape == (200, 30)
    return route, motion, body, dict(zip(COLUMNS, rows.T, strict=True))


def test_speed_and_yaw_integrate_to_the_track(driven: Drive) -> None:
    _, motion, _, oxts = driven
    yaw = np.unwrap(oxts["yaw"])
    v, dt, turn = oxts["vf"], np.diff(motion.time_s), np.diff(yaw)
    length = (v[1:] + v[:-1]) / 2 * dt * np.sinc(turn / 2 / np.pi)  # chord of an arc
    middle = (yaw[1:] + yaw[:-1]) / 2
    track = np.cumsum(length[:, None] * np.stack([np.cos(middle), np.sin(middle)], axis=-1), axis=0)
    # Second route: KITTI's own Mercator projection.
    scale = np.cos(np.deg2rad(oxts["lat"][0])) * 6378137.0
    east = scale * np.deg2rad(oxts["lon"])
    north = scale * np.log(np.tan(np.deg2rad(90 + oxts["lat"]) / 2))
    measured = np.stack([east - east[0], north - north[0]], axis=-1)[1:]
    assert np.linalg.norm(measured[-1]) > 30
    assert np.linalg.norm(track - measured, axis=1).max() < 0.10


def test_label_is_the_curvature_of_the_path_a_moment_earlier(driven: Drive) -> None:
    route, motion, _, oxts = driven
    moving = oxts["vf"] > 1
    label = steering_angle(oxts["wu"], oxts["vf"], 2.7)
    s_m, speed_mps = (
        np.interp(motion.time_s - RATES_LATE_S, motion.time_s, values) for values in (motion.s_m, motion.speed_mps)
    )
    faster = speed_mps[moving] / oxts["vf"][moving]  # a moment ago: the speed is not late
    np.testing.assert_allclose(np.tan(label[moving]), 2.7 * route.curvature(s_m)[moving] * faster, atol=1e-12)
    assert label.max() > 0.1  # left and right
    assert label.min() < -0.1
