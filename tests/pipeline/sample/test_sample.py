"""The sample: routes, motion, sensors and rays; images, depths, scans and packets show the same
scene.
"""

from itertools import product

import cv2
import numpy as np
import pytest

from pipeline.base.checkout import ROOT
from pipeline.base.params import load_section
from pipeline.camera import classes, geometry
from pipeline.camera.images import read_pixels, to_metres
from pipeline.ingest.datasets.kitti import KittiDrive, read_scan
from pipeline.ingest.packets import COLUMNS
from pipeline.ingest.settings import Ingest
from pipeline.labels.label import steering_angle
from pipeline.sample import journey as journeys
from pipeline.sample import shapes
from pipeline.sample.inertial import RATES_LATE_S, oxts_rows
from pipeline.sample.journey import (
    ACCELERATE_MPS2,
    BRAKE_MPS2,
    Journey,
    draw_body,
    draw_journey,
    frame_times,
    speed_profile,
)
from pipeline.sample.light import draw_ground_colours
from pipeline.sample.plan import draw_character, draw_plan
from pipeline.sample.render import choose_theme, random_of, render_drive
from pipeline.sample.rig import make_rig, write_calibration
from pipeline.sample.route import (
    AHEAD_M,
    DECK,
    IMU_LEFT_M,
    STEP_M,
    draw_route,
    rotation_matrix,
    unit_vector,
)
from pipeline.sample.scenery import build_street
from pipeline.sample.settings import Sample
from pipeline.sample.traffic import draw_traffic
from pipeline.sample.world import World, _Layer
from tests.kitti_drive import contents


@pytest.mark.parametrize(("seed", "first"), [*enumerate(DECK)])
def test_roads_are_smooth_match_their_curvature_and_do_not_cross_themselves(seed, first):
    route = draw_route(np.random.default_rng(seed), 60 + AHEAD_M, 3.5, first)
    assert np.abs(np.diff(route.curvature_1pm)).max() < 0.006  # 1/m per 0.1 m
    steps = np.diff(route.xy, axis=0)
    turned = np.diff(np.unwrap(np.arctan2(steps[:, 1], steps[:, 0])))
    np.testing.assert_allclose(turned / STEP_M, route.curvature_1pm[1:-1], atol=2e-3)
    np.testing.assert_allclose(np.linalg.norm(steps, axis=1), STEP_M)
    s_m = route.s_m[::20]
    xy = route.xy[::20]
    apart_m = np.linalg.norm(xy[:, None] - xy, axis=-1)
    far = np.abs(s_m[:, None] - s_m) > 60
    assert apart_m[far].min() > 20


@pytest.fixture(scope="module", params=[(1, None), (3, 40.0)], ids=["drives on", "stops"])
def journey(request) -> Journey:
    seed, stop_m = request.param
    rng = np.random.default_rng(seed)
    time_s = frame_times(rng, 200)
    route = draw_route(rng, 9.0 * time_s[-1] + AHEAD_M, 3.5, "left")
    speed_mps = speed_profile(route, 9.0, 3.0, stop_m)
    travel = journeys.drive_route(route, speed_mps, time_s, 2.0)
    return Journey(route, travel, travel, draw_body(route, travel, rng))


def test_the_ego_keeps_the_limits_of_its_driver(journey):
    motion = journey.motion
    assert (np.diff(motion.s_m) >= 0).all()
    assert motion.acceleration_mps2.min() >= -BRAKE_MPS2 - 1e-9
    assert motion.acceleration_mps2.max() <= ACCELERATE_MPS2 + 1e-9
    sideways_mps2 = motion.speed_mps**2 * np.abs(journey.route.curvature(motion.s_m))
    assert sideways_mps2.max() < 3.0 * 1.05  # between samples of the route it may be a bit more


def oxts_columns(journey: Journey) -> dict[str, np.ndarray]:
    """Return the columns [F] of the journey's oxts packets by name."""
    return dict(zip(COLUMNS, oxts_rows(journey, 49.0, 8.4).T, strict=True))


def test_speed_and_yaw_in_oxts_integrate_to_the_track(journey):
    oxts = oxts_columns(journey)
    speed_mps = oxts["vf"]
    yaw = np.unwrap(oxts["yaw"])
    arc_m = (speed_mps[1:] + speed_mps[:-1]) / 2 * np.diff(journey.motion.time_s)
    chord_m = arc_m * np.sinc(np.diff(yaw) / 2 / np.pi)
    heading_rad = (yaw[1:] + yaw[:-1]) / 2
    track = np.cumsum(chord_m[:, None] * unit_vector(heading_rad), axis=0)

    # Second route: KITTI's own Mercator projection.
    scale_m = np.cos(np.deg2rad(oxts["lat"][0])) * 6378137.0
    east_m = scale_m * np.deg2rad(oxts["lon"])
    north_m = scale_m * np.log(np.tan(np.deg2rad(90 + oxts["lat"]) / 2))
    measured = np.stack([east_m - east_m[0], north_m - north_m[0]], axis=-1)[1:]
    assert np.linalg.norm(measured[-1]) > 30
    assert np.linalg.norm(track - measured, axis=1).max() < 0.10


def test_the_label_is_the_curvature_of_the_path_a_moment_earlier(journey):
    oxts = oxts_columns(journey)
    moving = oxts["vf"] > 1
    label = steering_angle(oxts["wu"], oxts["vf"], 2.7)

    # The recorded rate is late, the recorded speed is not.
    motion = journey.motion
    earlier_s = motion.time_s - RATES_LATE_S
    s_m = np.interp(earlier_s, motion.time_s, motion.s_m)
    speed_mps = np.interp(earlier_s, motion.time_s, motion.speed_mps)
    curvature_1pm = journey.route.curvature(s_m)[moving]
    faster = speed_mps[moving] / oxts["vf"][moving]
    expected = 2.7 * curvature_1pm * faster
    np.testing.assert_allclose(np.tan(label[moving]), expected, atol=1e-12)
    assert label.min() < -0.1 < 0.1 < label.max()


def optics(date: str) -> tuple[float, ...]:
    """Return focal length and principal point per width, and the height over the IMU in metres."""
    rig = make_rig((96, 320), date)
    (f, _, x), (_, _, y), _ = (rig.P_rect[2][:, :3] / rig.size[1]).tolist()
    return f, x, y, float(np.linalg.inv(rig.T_cam2_imu)[2, 3])


def test_the_dates_of_test_drives_have_other_cameras_within_the_range_of_the_training_dates():
    drives = load_section(Ingest, ROOT / "params.yaml").drives
    train = {optics(drive[:10]) for drive in drives.train}
    val = {optics(drive[:10]) for drive in drives.val}
    test_dates = {drive[:10] for drive in drives.test}
    test = {optics(date) for date in test_dates}
    assert len(test) == len(test_dates)
    assert not test & (train | val)

    lowest = np.min([*train], axis=0)
    highest = np.max([*train], axis=0)
    # A date that no table names draws its own camera.
    drawn = {optics(f"2027_05_{day:02d}") for day in range(1, 11)}
    assert len(drawn) == 10
    for camera in test | drawn:
        assert (lowest <= camera).all()
        assert (camera <= highest).all()


@pytest.mark.parametrize("drive", ["2026_01_01_drive_0001", "2026_01_06_drive_0003"])
def test_ego_touches_nothing(drive):
    """The ego's outline stays on the road, and rays from frame to frame hit nothing.

    The drives are in a tight right turn and in a narrow street.
    """
    rng = random_of(drive, seed=0)
    quarter, first = choose_theme(drive)
    character = draw_character(rng, quarter)
    journey = draw_journey(rng, 60, character, first)
    plan = draw_plan(journey.route, rng, character)
    street = build_street(journey.route, plan, character, rng)
    world = World(plan, street, draw_ground_colours(rng))

    # Points of the outline are relative to the centre of the rear axle.
    xy, heading_rad = journey.route.place_at(journey.motion.s_m)
    ahead = unit_vector(heading_rad)
    left = unit_vector(heading_rad + np.pi / 2)
    for ahead_m, left_m in product((-0.8, 1.3, 3.5), (-0.85, 0.0, 0.85)):
        places = xy + ahead_m * ahead + (left_m - IMU_LEFT_M) * left
        assert (plan.to_road_m[plan.cells_at(*places.T)] == 0).all()
        steps = np.diff(places, axis=0)
        length_m = np.linalg.norm(steps, axis=1)
        rays = np.zeros((6, len(steps)), np.float32)
        rays[:2] = places[:-1].T
        rays[3:5] = (steps / length_m[:, None]).T
        for height_m in (0.4, 1.5):
            rays[2] = height_m
            assert (world.cast_rays(rays).distance_m > length_m).all()


@pytest.mark.parametrize("seed", range(6))
def test_visible_cars_do_not_touch_the_ego(seed):
    """In the narrow streets of these drives, many are hidden."""
    rng = np.random.default_rng(seed)
    journey = draw_journey(rng, 150, draw_character(rng, "narrow"), "sweep+")
    ego_xy, heading_rad = journey.route.place_at(journey.motion.s_m)
    middle = ego_xy + 1.3 * unit_vector(heading_rad) - 0.3 * unit_vector(heading_rad + np.pi / 2)
    cars = draw_traffic(journey, rng)
    assert cars
    for car in cars:
        apart_m = np.linalg.norm(car.xy - middle, axis=1)
        assert (apart_m[car.visible] > 2.3).all()
        # A car appears and vanishes only far away, at the latest at the end of the road.
        appears = np.diff(car.visible.astype(int), prepend=int(car.visible[0])) != 0
        assert (apart_m[appears] > 45).all()


def test_rays_hit_the_sides_of_a_box_and_none_is_left_out():
    """Rays that miss the bounding sphere of a mesh are not cast at it."""
    rng = np.random.default_rng(0)
    box = shapes.build_box((4.0, 2.0, 1.5), (0.5, 0.5, 0.5), classes.CAR)
    layer = _Layer(box.moved_to((3.0, 1.0), heading_rad=0.7))
    rays = rng.normal(size=(6, 4000)).astype(np.float32)
    rays[:3] *= 6
    rays[3:] /= np.linalg.norm(rays[3:], axis=0)
    distance_m, _, _ = layer.cast_rays(rays)
    hit = np.flatnonzero(np.isfinite(distance_m))
    assert len(hit) > 50
    assert np.isin(hit, layer.find_candidates(rays)).all()

    # In the frame of the box, the points of the hits are on its sides.
    points = (rays[:3] + distance_m * rays[3:])[:, hit] - [[3.0], [1.0], [0.0]]
    places = rotation_matrix(0, 0, 0.7).T @ points
    beyond_m = np.abs(places - [[0], [0], [0.75]]) - [[2.0], [1.0], [0.75]]
    np.testing.assert_allclose(beyond_m.max(axis=0), 0, atol=1e-4)


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


def test_a_drive_is_determined_by_its_name_and_the_seed(drive, tmp_path):
    """Its images are the same without scans, as those of each frame have their own noise."""
    settings = Sample.model_construct(image_size=SIZE, seed=0, scan_rays=(32, 200))
    render_drive(tmp_path, NAME, settings, frames=FRAMES, lidar=False, truth=False)
    again = contents(tmp_path)
    expected = contents(drive.folder)
    assert again == {name: expected[name] for name in again}
    assert len(again) == FRAMES + FRAMES + 45 + 2  # images, packets and their timestamps
    settings = settings.model_copy(update={"seed": 1})
    render_drive(tmp_path / "b", NAME, settings, frames=1, lidar=False, truth=False)
    other = contents(tmp_path / "b")
    assert other["oxts/data/0000000000.txt"] != expected["oxts/data/0000000000.txt"]


def pixels_inside(uv: np.ndarray, border: float) -> np.ndarray:
    """Return bool [N]: pixels [N,2] are in the image and at least `border` from its edges."""
    height, width = SIZE
    u, v = uv.T
    inside_u = (u > border) & (u < width - 1 - border)
    inside_v = (v > border) & (v < height - 1 - border)
    return inside_u & inside_v


def test_scans_agree_with_dense_depth(drive):
    camera = drive.read_camera(2)
    errors_m = []
    for frame in (0, FRAMES - 1):
        depth_m = to_metres(read_pixels(drive.truth_depth[frame]))
        x, y, z, _ = read_scan(drive.scans[frame]).astype(np.float64).T
        points = geometry.transform(camera.T_cam_velo, np.stack([x, y, z], axis=-1))
        uv, z = geometry.project(points, camera.K)
        inside = (z > 0) & pixels_inside(uv, border=0)
        assert inside.sum() > 300

        # On a plane, inverse depth is linear in the pixel. The median disregards silhouettes.
        u, v = uv[inside].T.astype(np.float32)
        inverse = cv2.remap(1 / np.maximum(depth_m, 1e-3), u, v, cv2.INTER_LINEAR)
        errors_m.append(np.abs(1 / inverse.ravel() - z[inside]))
    assert np.median(np.concatenate(errors_m)) < 0.05


def test_static_world_moves_as_oxts_measures(drive):
    """Points of the first frame, moved by the motion in oxts, land on the last frame's surfaces."""
    first = dict(zip(COLUMNS, np.loadtxt(drive.oxts[0]), strict=True))
    last = dict(zip(COLUMNS, np.loadtxt(drive.oxts[FRAMES - 1]), strict=True))

    def T_first_imu(oxts: dict[str, float]) -> np.ndarray:
        """Return the pose [4,4] of a packet's IMU relative to the first frame's place."""
        parallel_radius_m = 6378137 * np.cos(np.deg2rad(first["lat"]))
        east_m = np.deg2rad(oxts["lon"] - first["lon"]) * parallel_radius_m
        north_m = np.deg2rad(oxts["lat"] - first["lat"]) * 6378137
        R = rotation_matrix(oxts["roll"], oxts["pitch"], oxts["yaw"])
        return geometry.rigid(R, (east_m, north_m, oxts["alt"]))

    T_cam2_imu = make_rig(SIZE, NAME[:10]).T_cam2_imu
    T_imu_last_first = np.linalg.inv(T_first_imu(last)) @ T_first_imu(first)
    T_last_first = T_cam2_imu @ T_imu_last_first @ np.linalg.inv(T_cam2_imu)

    # Surfaces up to 40 m ahead that do not move.
    camera = drive.read_camera(2)
    depth_m = to_metres(read_pixels(drive.truth_depth[0]))
    cls = read_pixels(drive.truth_cls[0])
    static = np.isin(cls, [classes.BUILDING, classes.ROAD, classes.SIDEWALK])
    static &= (depth_m > 0) & (depth_m < 40)
    points = geometry.back_project(depth_m, camera.K)[static]

    uv, z = geometry.project(geometry.transform(T_last_first, points), camera.K)
    inside = (z > 3) & pixels_inside(uv, border=0.5)
    u, v = np.rint(uv[inside]).astype(int).T
    last_depth_m = to_metres(read_pixels(drive.truth_depth[FRAMES - 1]))
    assert inside.sum() > 2000
    assert np.median(np.abs(last_depth_m[v, u] - z[inside]) / z[inside]) < 0.02
