"""Routes, the ego's motion, its sensors and rays: what is rendered is consistent with oxts and calibration."""

from pathlib import Path

import numpy as np
import pytest

from pipeline.base.params import load
from pipeline.base.resume import ROOT
from pipeline.camera import classes
from pipeline.kitti.oxts import COLUMNS
from pipeline.kitti.raw import cameras_in, read_calibration
from pipeline.labels.label import steering_angle
from pipeline.sample import shapes
from pipeline.sample.light import draw_ground_colours
from pipeline.sample.manoeuvres import DECK, draw_route
from pipeline.sample.motion import Journey, draw_body, drive, frame_times, speed_profile
from pipeline.sample.oxts import RATES_LATE_S, oxts_rows
from pipeline.sample.plan import ASPHALT, GRASS, KERB_M, Plan
from pipeline.sample.rig import make_rig, write_calibration
from pipeline.sample.route import AHEAD_M, STEP_M
from pipeline.sample.world import World
from pipeline.settings.ingest import Ingest


@pytest.mark.parametrize(("seed", "first"), [*enumerate(DECK)])
def test_roads_are_smooth_match_their_curvature_and_do_not_cross_themselves(seed: int, first: str) -> None:
    route = draw_route(np.random.default_rng(seed), 60 + AHEAD_M, 3.5, first)
    assert np.abs(np.diff(route.curvature_1pm)).max() < 0.006  # 1/m per 0.1 m
    steps = np.diff(route.xy, axis=0)
    turned = np.diff(np.unwrap(np.arctan2(steps[:, 1], steps[:, 0])))
    np.testing.assert_allclose(turned / STEP_M, route.curvature_1pm[1:-1], atol=2e-3)
    np.testing.assert_allclose(np.linalg.norm(steps, axis=1), STEP_M)
    s, xy = route.s_m[::20], route.xy[::20]
    apart = np.linalg.norm(xy[:, None] - xy[None], axis=-1)
    assert apart[np.abs(s[:, None] - s[None]) > 60].min() > 20


@pytest.fixture(scope="module", params=[(1, ()), (3, (40.0,))], ids=["drives on", "stops"])
def journey(request: pytest.FixtureRequest) -> Journey:
    seed, stops = request.param
    rng = np.random.default_rng(seed)
    times = frame_times(rng, 200)
    route = draw_route(rng, 9.0 * times[-1] + AHEAD_M, 3.5, "left")
    motion = drive(route, speed_profile(route, 9.0, 3.0, stops), times, 2.0)
    return Journey(route, motion, motion, draw_body(route, motion, rng))


def test_speed_and_yaw_in_oxts_integrate_to_the_track(journey: Journey) -> None:
    oxts = dict(zip(COLUMNS, oxts_rows(journey, 49.0, 8.4).T, strict=True))
    yaw = np.unwrap(oxts["yaw"])
    v, dt, turn = oxts["vf"], np.diff(journey.motion.time_s), np.diff(yaw)
    length = (v[1:] + v[:-1]) / 2 * dt * np.sinc(turn / 2 / np.pi)  # chord of an arc
    middle = (yaw[1:] + yaw[:-1]) / 2
    track = np.cumsum(length[:, None] * np.stack([np.cos(middle), np.sin(middle)], axis=-1), axis=0)
    # Second route: KITTI's own Mercator projection.
    scale = np.cos(np.deg2rad(oxts["lat"][0])) * 6378137.0
    east, north = scale * np.deg2rad(oxts["lon"]), scale * np.log(np.tan(np.deg2rad(90 + oxts["lat"]) / 2))
    measured = np.stack([east - east[0], north - north[0]], axis=-1)[1:]
    assert np.linalg.norm(measured[-1]) > 30
    assert np.linalg.norm(track - measured, axis=1).max() < 0.10


def test_the_label_is_the_curvature_of_the_path_a_moment_earlier(journey: Journey) -> None:
    oxts, motion = dict(zip(COLUMNS, oxts_rows(journey, 49.0, 8.4).T, strict=True)), journey.motion
    moving, label = oxts["vf"] > 1, steering_angle(oxts["wu"], oxts["vf"], 2.7)
    s_m, speed_mps = (
        np.interp(motion.time_s - RATES_LATE_S, motion.time_s, values) for values in (motion.s_m, motion.speed_mps)
    )
    faster = speed_mps[moving] / oxts["vf"][moving]  # a moment ago: the speed is not late
    np.testing.assert_allclose(np.tan(label[moving]), 2.7 * journey.route.curvature(s_m)[moving] * faster, atol=1e-12)
    assert label.min() < -0.1 < 0.1 < label.max()


@pytest.mark.parametrize("date", ["2026_01_01", "2026_01_05"])
def test_calibration_files_describe_the_rig(tmp_path: Path, date: str) -> None:
    rig = make_rig((188, 621), date)
    write_calibration(rig, tmp_path / date)
    assert cameras_in(tmp_path / date) == [0, 1, 2, 3]
    camera = read_calibration(tmp_path / date, 2)
    assert camera.size == (188, 621)
    np.testing.assert_allclose(camera.K, rig.camera.K, atol=1e-9)
    assert camera.T_cam_velo is not None
    np.testing.assert_allclose(camera.T_cam_velo @ rig.T_velo_imu, rig.T_cam2_imu, atol=1e-9)
    np.testing.assert_allclose(camera.T_cam_velo[:3, :3] @ camera.T_cam_velo[:3, :3].T, np.eye(3), atol=1e-9)


def test_the_test_drives_of_the_sample_have_dates_and_cameras_of_their_own() -> None:
    drives = load(Ingest, ROOT / "params.yaml").drives
    dates = {split: {drive[:10] for drive in getattr(drives, split)} for split in ("train", "val", "test")}
    cameras = {split: {make_rig((96, 320), date).P_rect[2].tobytes() for date in dates[split]} for split in dates}
    assert len(drives.test) >= 20
    for other in ("train", "val"):
        assert not dates["test"] & dates[other]
        assert not cameras["test"] & cameras[other]


@pytest.fixture(scope="module")
def world() -> World:
    """Return a world with road at x < 0, grass elsewhere and a wall of 2 m at x = 10."""
    kind = np.full((400, 400), GRASS, np.uint8)
    kind[:, :200] = ASPHALT
    plan = Plan(kind, (kind == GRASS).astype(np.float32), np.array([-20.0, -20.0]), {}, np.zeros(0, bool))
    wall = shapes.box((1.0, 6.0, 2.0), (0.5, 0.4, 0.3), classes.BUILDING).placed((10.5, 0.0), z=KERB_M)
    return World(plan, wall, draw_ground_colours(np.random.default_rng(0)))


def rays(*pairs: tuple[list[float], list[float]]) -> np.ndarray:
    array = np.array([origin + direction for origin, direction in pairs], np.float32).T
    array[3:] /= np.linalg.norm(array[3:], axis=0)
    return array


def test_rays_hit_road_grass_and_wall(world: World) -> None:
    down = [0.0, 0.0, -1.0]  # the road is at the bottom of the kerb, grass at its top
    hits = world.cast(
        rays(([-5.0, 0, 3], down), ([5.0, 0, 3], down), ([0.5, 0, 1], [1, 0, 0]), ([0.5, 0, 2.5], [1, 0, 0]))
    )
    np.testing.assert_array_equal(hits.cls, [classes.ROAD, classes.TERRAIN, classes.BUILDING, classes.SKY])
    np.testing.assert_allclose(hits.distance_m, [3, 3 - KERB_M, 9.5, np.inf], rtol=1e-5)
    np.testing.assert_allclose(hits.normal.T, [[0, 0, 1], [0, 0, 1], [-1, 0, 0], [0, 0, 0]], atol=1e-6)
