"""The sample: routes, motion, sensors and rays; images, depths, scans and packets show the same
scene.
"""

from itertools import product

import cv2
import numpy as np
import pytest

from pipeline.base.params import load
from pipeline.base.resume import ROOT
from pipeline.camera import classes, geometry
from pipeline.camera.images import read_pixels, to_metres
from pipeline.ingest.datasets.kitti import KittiDrive, read_scan
from pipeline.ingest.packets import COLUMNS
from pipeline.ingest.settings import Ingest
from pipeline.labels.label import steering_angle
from pipeline.sample import journey as journeys
from pipeline.sample.inertial import RATES_LATE_S, oxts_rows
from pipeline.sample.journey import Journey, draw_body, draw_journey, frame_times, speed_profile
from pipeline.sample.light import draw_ground_colours
from pipeline.sample.plan import draw_character, draw_plan
from pipeline.sample.render import random_of, render_drive, theme
from pipeline.sample.rig import make_rig, write_calibration
from pipeline.sample.route import AHEAD_M, DECK, IMU_LEFT_M, STEP_M, draw_route, rotation, unit
from pipeline.sample.scenery import build_street
from pipeline.sample.settings import Sample
from pipeline.sample.world import World


@pytest.mark.parametrize(("seed", "first"), [*enumerate(DECK)])
def test_roads_are_smooth_match_their_curvature_and_do_not_cross_themselves(seed, first):
    route = draw_route(np.random.default_rng(seed), 60 + AHEAD_M, 3.5, first)
    assert np.abs(np.diff(route.curvature_1pm)).max() < 0.006  # 1/m per 0.1 m
    steps = np.diff(route.xy, axis=0)
    turned = np.diff(np.unwrap(np.arctan2(steps[:, 1], steps[:, 0])))
    np.testing.assert_allclose(turned / STEP_M, route.curvature_1pm[1:-1], atol=2e-3)
    np.testing.assert_allclose(np.linalg.norm(steps, axis=1), STEP_M)
    s, xy = route.s_m[::20], route.xy[::20]
    apart = np.linalg.norm(xy[:, None] - xy[None], axis=-1)
    assert apart[np.abs(s[:, None] - s[None]) > 60].min() > 20


@pytest.fixture(scope="module", params=[(1, None), (3, 40.0)], ids=["drives on", "stops"])
def journey(request) -> Journey:
    seed, stop_m = request.param
    rng = np.random.default_rng(seed)
    times = frame_times(rng, 200)
    route = draw_route(rng, 9.0 * times[-1] + AHEAD_M, 3.5, "left")
    travel = journeys.drive(route, speed_profile(route, 9.0, 3.0, stop_m), times, 2.0)
    return Journey(route, travel, travel, draw_body(route, travel, rng))


def test_speed_and_yaw_in_oxts_integrate_to_the_track(journey):
    oxts = dict(zip(COLUMNS, oxts_rows(journey, 49.0, 8.4).T, strict=True))
    yaw = np.unwrap(oxts["yaw"])
    v, dt, turn = oxts["vf"], np.diff(journey.motion.time_s), np.diff(yaw)
    length = (v[1:] + v[:-1]) / 2 * dt * np.sinc(turn / 2 / np.pi)  # chord of an arc
    middle = (yaw[1:] + yaw[:-1]) / 2
    track = np.cumsum(length[:, None] * np.stack([np.cos(middle), np.sin(middle)], axis=-1), axis=0)
    # Second route: KITTI's own Mercator projection.
    scale = np.cos(np.deg2rad(oxts["lat"][0])) * 6378137.0
    east, north = (
        scale * np.deg2rad(oxts["lon"]),
        scale * np.log(np.tan(np.deg2rad(90 + oxts["lat"]) / 2)),
    )
    measured = np.stack([east - east[0], north - north[0]], axis=-1)[1:]
    assert np.linalg.norm(measured[-1]) > 30
    assert np.linalg.norm(track - measured, axis=1).max() < 0.10


def test_the_label_is_the_curvature_of_the_path_a_moment_earlier(journey):
    oxts, motion = dict(zip(COLUMNS, oxts_rows(journey, 49.0, 8.4).T, strict=True)), journey.motion
    moving, label = oxts["vf"] > 1, steering_angle(oxts["wu"], oxts["vf"], 2.7)
    s_m, speed_mps = (
        np.interp(motion.time_s - RATES_LATE_S, motion.time_s, values)
        for values in (motion.s_m, motion.speed_mps)
    )
    faster = speed_mps[moving] / oxts["vf"][moving]  # the speed is not late
    np.testing.assert_allclose(
        np.tan(label[moving]), 2.7 * journey.route.curvature(s_m)[moving] * faster, atol=1e-12
    )
    assert label.min() < -0.1 < 0.1 < label.max()


def optics(date: str) -> tuple[float, ...]:
    """Return focal length and principal point as shares of the image, and the height over the IMU
    in metres.
    """
    rig = make_rig((96, 320), date)
    (f, _, x), (_, _, y), _ = (rig.P_rect[2][:, :3] / rig.size[1]).tolist()
    return f, x, y, float(np.linalg.inv(rig.T_cam2_imu)[2, 3])


def test_the_dates_of_test_drives_have_other_cameras_within_the_range_of_the_training_dates():
    drives = load(Ingest, ROOT / "params.yaml").drives
    train, val, test = (
        {drive[:10] for drive in names} for names in (drives.train, drives.val, drives.test)
    )
    assert not test & (train | val)
    assert len({optics(date) for date in train | val | test}) == len(
        {*map(optics, train | val)}
    ) + len(test)
    known, new = (np.array([*map(optics, dates)]) for dates in (train, test))
    assert ((known.min(axis=0) <= new) & (new <= known.max(axis=0))).all()


@pytest.mark.parametrize("drive", ["2026_01_01_drive_0001", "2026_01_06_drive_0003"])
def test_ego_touches_nothing(drive):
    """In a tight right turn and a narrow street: the outline is on road, and rays from frame to
    frame hit nothing.
    """
    rng, (quarter, first) = random_of(drive, seed=0), theme(drive)
    character = draw_character(rng, quarter)
    journey = draw_journey(rng, 60, character, first)
    plan = draw_plan(journey.route, rng, character)
    world = World(plan, build_street(journey.route, plan, character, rng), draw_ground_colours(rng))
    xy, heading_rad = journey.route.at(journey.motion.s_m)
    ahead, left = unit(heading_rad), unit(heading_rad + np.pi / 2)
    # from the centre of the rear axle
    for forward, aside in product((-0.8, 1.3, 3.5), (-0.85, 0.0, 0.85)):
        places = xy + forward * ahead + (aside - IMU_LEFT_M) * left
        assert (plan.to_road_m[plan.cells(*places.T)] == 0).all()
        steps = np.diff(places, axis=0)
        length = np.linalg.norm(steps, axis=1)
        for height in (0.4, 1.5):
            starts = np.column_stack([places[:-1], np.full(len(steps), height)])
            rays = np.column_stack([starts, steps / length[:, None], np.zeros(len(steps))]).astype(
                np.float32
            )
            assert (world.cast(rays.T).distance_m > length).all()


NAME = "2026_01_01_drive_0001"
SIZE = (96, 320)
FRAMES = 8


@pytest.fixture(scope="module")
def drive(tmp_path_factory) -> KittiDrive:
    path = tmp_path_factory.mktemp("sample") / NAME[:10] / f"{NAME}_sync"
    settings = Sample.model_construct(image_size=SIZE, seed=0, scan_rays=(32, 200))
    render_drive(path, NAME, settings, frames=FRAMES, lidar=True, truth=True)
    write_calibration(make_rig(SIZE, NAME[:10]), path.parent)
    return KittiDrive(path)


def test_scans_agree_with_dense_depth(drive):
    camera = drive.camera(2)
    errors = []
    for frame in (0, FRAMES - 1):
        depth = to_metres(read_pixels(drive.truth_depth[frame]))
        points = geometry.transform(
            camera.T_cam_velo, read_scan(drive.scans[frame])[:, :3].astype(np.float64)
        )
        uv, z = geometry.project(points, camera.K)
        inside = (
            (z > 0) & (uv > 0).all(axis=1) & (uv[:, 0] < SIZE[1] - 1) & (uv[:, 1] < SIZE[0] - 1)
        )
        # On a plane, inverse depth is linear in the pixel. The median disregards silhouettes.
        inverse = cv2.remap(
            1 / np.maximum(depth, 1e-3), *uv[inside].T.astype(np.float32), cv2.INTER_LINEAR
        )
        assert inside.sum() > 300
        errors.append(np.abs(1 / inverse.ravel() - z[inside]))
    assert np.median(np.concatenate(errors)) < 0.05


def test_static_world_moves_as_oxts_measures(drive):
    """Points of the first frame, moved by the motion in oxts, land on the last frame's surfaces."""
    camera, rig = drive.camera(2), make_rig(SIZE, NAME[:10])
    rows = [np.loadtxt(drive.oxts[frame]) for frame in (0, FRAMES - 1)]
    poses = []
    for row in rows:
        east = np.deg2rad(row[1] - rows[0][1]) * 6378137 * np.cos(np.deg2rad(rows[0][0]))
        north = np.deg2rad(row[0] - rows[0][0]) * 6378137
        poses.append(geometry.rigid(rotation(*row[3:6]), (east, north, row[2])))
    T_last_first = (
        rig.T_cam2_imu @ np.linalg.inv(poses[1]) @ poses[0] @ np.linalg.inv(rig.T_cam2_imu)
    )
    depths = [to_metres(read_pixels(drive.truth_depth[frame])) for frame in (0, FRAMES - 1)]
    cls = read_pixels(drive.truth_cls[0])
    static = (
        (depths[0] > 0)
        & (depths[0] < 40)
        & np.isin(cls, [classes.BUILDING, classes.ROAD, classes.SIDEWALK])
    )
    points = geometry.transform(T_last_first, geometry.back_project(depths[0], camera.K)[static])
    uv, z = geometry.project(points, camera.K)
    inside = (
        (z > 3) & (uv > 0.5).all(axis=1) & (uv[:, 0] < SIZE[1] - 1.5) & (uv[:, 1] < SIZE[0] - 1.5)
    )
    u, v = np.rint(uv[inside]).astype(int).T
    assert inside.sum() > 2000
    assert np.median(np.abs(depths[1][v, u] - z[inside]) / z[inside]) < 0.02
