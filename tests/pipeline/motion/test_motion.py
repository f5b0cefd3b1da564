"""Measured motion: poses, the road's slope and scale, rates, the filtered speed, and odometry on a
rendered street.
"""

import re
from contextlib import nullcontext
from dataclasses import replace
from itertools import pairwise

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.base.errors import InputError
from pipeline.camera import classes
from pipeline.camera.camera import Camera, Frame
from pipeline.camera.geometry import project, transform
from pipeline.motion import horizon, step
from pipeline.motion.doubts import check_unit, find_doubts
from pipeline.motion.odometry import Odometry
from pipeline.motion.pose import estimate_pose
from pipeline.motion.roll import Roll
from pipeline.motion.step import TYPICAL_MPS, filter_speed
from pipeline.motion.still import Still, lowest_share
from tests import street
from tests.street import pose

K, POINTS = street.WIDE.K, 60


def points(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Return pixels [N,2] and their points [N,3], 3 to 60 m ahead."""
    uv = rng.uniform([0, 0], [320, 96], (POINTS, 2))
    z = rng.uniform(3, 60, POINTS)
    return uv, np.column_stack([(uv - K[:2, 2]) / np.diag(K)[:2] * z[:, None], z])


def test_half_of_the_points_are_enough_only_for_a_motion_like_the_previous_one():
    _, xyz = points(np.random.default_rng(0))
    forth, lorry = np.linalg.inv(pose(0, 0, 1.0)), np.linalg.inv(pose(0.1, 0.5, -1.0))
    static = np.arange(POINTS) % 20 < 11
    uv = np.where(
        static[:, None], project(transform(forth, xyz), K)[0], project(transform(lorry, xyz), K)[0]
    )
    sigma = np.full(POINTS, 0.1)
    assert estimate_pose(xyz, uv, K, sigma) is None
    assert estimate_pose(xyz, uv, K, sigma, np.linalg.inv(pose(0, 0, 3.0))) is None
    found = estimate_pose(xyz, uv, K, sigma, np.linalg.inv(pose(0, 0, 1.2)))
    np.testing.assert_allclose(found.T_now_before, forth, atol=0.01)


@pytest.mark.parametrize("seed", range(4))
def test_the_last_motion_is_a_start_where_most_depths_are_wrong(seed):
    rng = np.random.default_rng(seed)
    xyz = 0.3 * points(rng)[1]
    forth = np.linalg.inv(pose(0.05, 0, 0.67))
    known = np.arange(POINTS) < 8
    wrong = np.where(known, 1, np.exp(rng.normal(0, 1, POINTS)))[:, None] * xyz
    uv, sigma = project(transform(forth, xyz), K)[0], np.where(known, 0.02, 1.0)
    errors = []
    for T_last in None, np.linalg.inv(pose(0.04, 0, 0.6)):
        found = estimate_pose(wrong, uv, K, sigma, T_last)
        errors.append(np.abs(found.T_now_before - forth).max())
    assert errors[1] < 0.004
    assert errors[1] < errors[0] / 3


@pytest.mark.parametrize("ahead_m", [0.0, 1.5])
@pytest.mark.parametrize("yaw_rate", [0.5, -0.5, 0.0])
def test_rates_are_those_of_the_axle_wherever_the_camera_is(yaw_rate, ahead_m):
    mount = np.eye(4)
    mount[2, 3] = ahead_m
    first, second = (T @ mount for T in street.arc(2, yaw_rate, 6.0))
    measured, speed = step.rates(np.linalg.inv(first) @ second, 0.1)
    assert measured == pytest.approx(yaw_rate)
    assert speed == pytest.approx(6.0, rel=1e-3)  # the chord of the arc


def test_durations_average_jitter_of_the_past_and_follow_another_rate():
    """As KITTI's times, on a grid of 10 ms; then every fourth frame is missing, then the rate is
    halved.
    """
    frame = np.concatenate([np.arange(60), 60 + 4 * np.arange(20), 140 + np.arange(20)])
    exact_s = np.interp(frame, [0, 140, 160], [0, 140 * 0.1037, 140 * 0.1037 + 20 * 0.2074])
    time_s = np.round(exact_s, 2)
    found = step.durations(frame, time_s)
    assert np.isnan(found[0])
    assert found[20:80] == pytest.approx(0.1037, rel=0.01)
    assert found[82:] == pytest.approx(0.2074, rel=0.02)
    assert np.abs(np.diff(time_s)[20:59] / 0.1037 - 1).max() > 0.03  # single differences are worse
    np.testing.assert_array_equal(step.durations(frame[:50], time_s[:50])[1:], found[1:50])


COUNT = 900
TIME_S = np.arange(COUNT) / 10


def filtered(
    speed_mps: np.ndarray, road: bool, noise: float = 0.01
) -> tuple[np.ndarray, np.ndarray]:
    rows = len(speed_mps)
    return filter_speed(TIME_S[:rows], speed_mps, np.full(rows, road), np.full(rows, noise))


def test_with_a_road_speed_is_that_of_the_images():
    """From 12 m/s to 1.5 m/s in 6 s, and back: as hard as a car brakes in traffic."""
    true_mps = 6.75 + 5.25 * np.cos(TIME_S * np.pi / 6)
    speed_mps, sigma = filtered(true_mps, road=True)
    assert np.abs(speed_mps - true_mps).max() < 0.1
    assert np.median(sigma) < 0.1
    # reversing and standing
    speed_mps, _ = filtered(np.array([-2.0] * 20 + [0.0] * 5), road=True, noise=0.02)
    assert speed_mps[10:20] == pytest.approx([-2.0] * 10, rel=0.05)
    assert (speed_mps[20:] == 0).all()


def test_without_a_road_the_scale_of_depth_is_not_believed():
    """Depth that makes bends slow, as measured with a lens of 17 degrees, must not make them
    sharp.
    """
    rng, error = np.random.default_rng(0), np.zeros(COUNT)
    for row in range(1, COUNT):
        error[row] = 0.96 * error[row - 1] + rng.normal(0, 0.6 * np.sqrt(1 - 0.96**2))
    speed_mps, sigma = filtered(14.0 * np.exp(error), road=False)
    assert np.log(speed_mps).std() < 0.2 < error.std()
    assert np.median(sigma) > 0.25  # it admits the uncertainty
    assert np.median(speed_mps) == pytest.approx(TYPICAL_MPS, rel=0.4)


@given(
    st.lists(st.tuples(st.floats(0.1, 40), st.booleans()), min_size=2, max_size=20),
    st.integers(1, 19),
)
def test_it_is_causal(rows, known):
    speed, road = np.array([speed for speed, _ in rows]), np.array([road for _, road in rows])
    noise = np.full(len(rows), 0.01)
    complete = filter_speed(TIME_S[: len(rows)], speed, road, noise)
    start = filter_speed(TIME_S[: len(rows)][:known], speed[:known], road[:known], noise[:known])
    np.testing.assert_array_equal(np.stack(complete)[:, :known], np.stack(start))


DT_S = 0.1


def views(*poses: np.ndarray) -> list[Frame]:
    images = map(street.view, poses)
    return [
        Frame(i, i * DT_S, image, depth_m, cls) for i, (image, depth_m, cls) in enumerate(images)
    ]


def measured(
    frames: list[Frame], camera: Camera = street.WIDE.at_height(street.WIDE.height_m)
) -> list[step.Step | None]:
    odometry = Odometry(camera)
    return [odometry.step(frame) for frame in frames]


def rates(steps: list[step.Step | None]) -> np.ndarray:
    """Return yaw rate and speed [F-1,2]; all but the first must be measured."""
    assert steps[0] is None
    assert all(steps[1:])
    return np.array([step.rates(one.T_before_now, DT_S) for one in steps[1:] if one])


@pytest.mark.parametrize(
    ("yaw_rate", "speed"), [(0.4, 6.0), (-0.4, 6.0), (0.0, 12.0), (0.05, 1.0), (0.0, -2.0)]
)
def test_known_motion_is_measured(yaw_rate, speed):
    steps = measured(views(*street.arc(4, yaw_rate, speed)))
    assert rates(steps)[:, 0] == pytest.approx(yaw_rate, abs=0.005)
    assert rates(steps)[:, 1] == pytest.approx(speed, rel=0.02, abs=0.05)
    for one in steps[1:]:
        assert one.inliers > 100
        assert one.residual < 0.4
        assert one.scale == pytest.approx(1, abs=0.02)


def test_motion_is_measured_since_the_frame_before_by_number():
    frames = views(*street.arc(6, 0.3, 6.0))
    assert [one is None for one in measured(frames[:3] + frames[4:])] == [
        True,
        False,
        False,
        True,
        False,
    ]


@pytest.mark.parametrize("road", [classes.ROAD, classes.CAR])
def test_a_wrong_scale_is_corrected_by_the_camera_height_also_where_road_has_the_class_of_cars(
    road,
):
    frames = [
        replace(
            frame,
            depth_m=0.7 * frame.depth_m,
            cls=np.where(frame.cls == classes.ROAD, road, frame.cls),
        )
        for frame in views(*street.arc(4, 0.2, 6.0))
        if frame.depth_m is not None
    ]
    steps = measured(frames)
    assert rates(steps)[:, 1] == pytest.approx(6.0, rel=0.03)
    assert [one.scale for one in steps[1:] if one] == pytest.approx([1 / 0.7] * 3, rel=0.02)
    uncorrected = measured(frames, street.WIDE)
    assert rates(uncorrected)[:, 1] == pytest.approx(0.7 * 6.0, rel=0.03)
    assert [one.scale for one in uncorrected[1:] if one] == [1.0] * 3
    assert rates(uncorrected)[:, 0] == pytest.approx(0.2, abs=0.01)


@pytest.mark.parametrize("reflection", [0.0, 0.4])
def test_a_bonnet_is_left_out(reflection):
    """Its texture stays in place under the reflection of a scene that moves; depth shows it 3 m
    away.
    """
    frames, bonnet = views(*street.arc(5, 0.2, 6.0)), slice(82, 96)
    texture = np.random.default_rng(0).integers(0, 255, (14, 320, 1), dtype=np.uint8)
    for frame in frames:
        mirrored = (1 - reflection) * texture + reflection * frame.image[13::-1]
        frame.image[bonnet], frame.depth_m[bonnet], frame.cls[bonnet] = mirrored, 3.0, classes.ROAD
    assert rates(measured(frames))[:, 1] == pytest.approx(6.0, rel=0.03)
    assert rates(measured(frames))[:, 0] == pytest.approx(0.2, abs=0.005)


@pytest.mark.parametrize(("speed", "yaw_rate"), [(0.0, 0.0), (0.3, 0.0), (8.0, 0.0), (8.0, 0.3)])
def test_a_street_is_no_bonnet(speed, yaw_rate):
    """Neither while the car stands, in noise, nor when it turns or moves slowly."""
    rng, still = np.random.default_rng(0), Still(street.WIDE)
    images = [
        street.view(pose)[0][..., 0] + rng.normal(0, 2, (96, 320))
        for pose in street.arc(4, yaw_rate, speed)
    ]
    for before, now in pairwise(np.clip(images, 0, 255).astype(np.uint8)):
        still.add(before, now, 0.0)
        assert not still.mask.any()
    passed_by = np.array([0, 0, 0.5, 0.5, 0.5])  # traffic moves, the car stands
    assert (
        lowest_share(passed_by, np.array([1, 1, 0, 0, 0]))
        == lowest_share(passed_by, np.zeros(5))
        == 0
    )
    assert lowest_share(passed_by, np.ones(5)) == 0.5


def test_traffic_is_excluded_by_its_class():
    """A bus ahead moves with the car and fills most of the view."""
    frames = views(*street.arc(3, 0.0, 6.0))
    bus = slice(10, 80), slice(60, 260)
    texture = np.random.default_rng(0).integers(0, 255, (70, 200, 1), dtype=np.uint8)
    for frame in frames:
        frame.image[bus], frame.depth_m[bus], frame.cls[bus] = texture, 8.0, classes.BUS
    assert rates(measured(frames))[:, 1] == pytest.approx(6.0, rel=0.05)
    for frame in frames:
        frame.cls[bus] = classes.BUILDING
    assert not any(
        one and abs(step.rates(one.T_before_now, DT_S)[1] - 6) < 0.3 for one in measured(frames)
    )


# Of a drive by day at 10 images per second.
HEALTHY = {
    "frames": 100,
    "valid": 98,
    "moving": 99,
    "step_s": 0.104,
    "step_m": 0.9,
    "still": 0.0,
    "roll_deg": 1.4,
    "road_frames": 99,
    "height_ratio": 1.0,
    "road_class": 0.8,
    "road_class_frames": 95,
    "unit_error": 1.8,
}


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"step_s": 0.207}, r"images are 0\.21 s apart"),
        ({"step_m": 2.3, "valid": 40}, r"images are 2\.3 m apart"),
        ({"valid": 88}, "only 88 of 99 frames with a moving car are measured"),
        ({"roll_deg": 3.2}, r"turned by 3° clockwise.*rotate=-3\*PI/180"),
        ({"roll_deg": -10.0}, r"turned by 10° counterclockwise.*rotate=10\*PI/180"),
        ({"road_class": 0.0}, "only 0% of the road .* classes of another numbering"),
        ({"road_frames": 5}, "depth shows a road in 5 frames, classes in 95: inverse depth"),
        ({"still": 0.1}, "a bonnet, or text"),
    ],
)
def test_doubts(changes, text):
    assert [*find_doubts(HEALTHY)] == []
    ((_, found),) = find_doubts(HEALTHY | changes)
    assert re.search(text, found)


@pytest.mark.parametrize(("ratio", "refused"), [(1.1, False), (3.9, True), (0.5, True)])
def test_depth_in_another_unit_is_refused(ratio, refused):
    """By the road of many frames, of one drive or of several."""
    drive = HEALTHY | {"height_ratio": ratio, "road_frames": 30}
    check_unit({"1": drive})
    check_unit({"1": drive | {"unit_error": np.inf, "road_frames": 300}})
    for drives in (
        {"1": drive, "2": drive},
        {"1": HEALTHY, "2": HEALTHY, "3": drive | {"road_frames": 50}},
    ):
        with (
            pytest.raises(InputError, match=f"road is {ratio:.2f} times")
            if refused
            else nullcontext()
        ):
            check_unit(drives)


@pytest.mark.parametrize("turned_deg", [-10, -3, 0, 3])
def test_roll_is_that_of_upright_edges(turned_deg):
    """Counterclockwise, as OpenCV turns images; an image without edges has none."""
    camera, rng = street.WIDE, np.random.default_rng(0)
    height, width = camera.size
    bars = np.repeat(rng.integers(0, 255, width // 8, np.uint8), 8)
    image = np.broadcast_to(bars[None, :, None], (height, width, 3)).copy()
    turn = cv2.getRotationMatrix2D((width / 2, height / 2), turned_deg, 1)
    roll = Roll(camera)
    roll.add(np.zeros_like(image))
    assert roll.degrees() == 0
    roll.add(cv2.warpAffine(image, turn, (width, height)))
    assert roll.degrees() == pytest.approx(-turned_deg, abs=0.5)


def test_a_black_image_shows_no_road():
    """Also where depth is that of a road."""
    frames = views(*street.arc(2, 0.0, 6.0))
    odometry = Odometry(street.WIDE)
    odometry.step(frames[0])
    assert odometry.road.frame_height_m > 0
    assert odometry.road_class > 0.5
    odometry.step(replace(frames[1], image=np.zeros_like(frames[1].image)))
    assert odometry.road.frame_height_m == 0
    assert np.isnan(odometry.road_class)


def test_images_upside_down_are_refused():
    images = [street.view(pose)[0] for pose in street.arc(60, 0.0, 8.0)]
    assert (
        horizon.find_horizon([Frame(0, 0.0, image) for image in images * 2], street.WIDE)
        is not None
    )
    with pytest.raises(InputError, match="images are upside down"):
        horizon.find_horizon(
            [Frame(0, 0.0, image[::-1, ::-1].copy()) for image in images], street.WIDE
        )
