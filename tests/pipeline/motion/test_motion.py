"""Measured motion: poses, rates, odometry on a rendered street, facts."""

from contextlib import nullcontext
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from pipeline.base.errors import InputError
from pipeline.camera import classes
from pipeline.camera.camera import Camera, Frame
from pipeline.camera.geometry import project, transform
from pipeline.motion import horizon, step
from pipeline.motion.facts import check_unit, facts_line, facts_lines
from pipeline.motion.odometry import Odometry, pick_corners
from pipeline.motion.pose import Matches, estimate_pose
from pipeline.motion.rates import estimate_noise
from pipeline.motion.still import Still
from tests import street
from tests.street import pose

K = street.WIDE.K
POINTS = 60


def points(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Return pixels [N,2] and their points [N,3], 3 to 60 m ahead."""
    uv = rng.uniform([0, 0], [320, 96], (POINTS, 2))
    z = rng.uniform(3, 60, POINTS)
    rays = (uv - K[:2, 2]) / np.diag(K)[:2]
    return uv, np.column_stack([rays * z[:, None], z])


def test_half_of_the_points_are_enough_only_for_a_motion_like_the_previous_one():
    """11 of 20 points are of the street, the others of a lorry."""
    _, xyz = points(np.random.default_rng(0))
    forth = np.linalg.inv(pose(0, 0, 1.0))
    lorry = np.linalg.inv(pose(0.1, 0.5, -1.0))
    uv_street, _ = project(transform(forth, xyz), K)
    uv_lorry, _ = project(transform(lorry, xyz), K)
    is_street = np.arange(POINTS) % 20 < 11
    uv = np.where(is_street[:, None], uv_street, uv_lorry)
    matches = Matches(xyz, np.full(POINTS, 0.1), uv)

    assert estimate_pose(matches, K) is None
    faster = np.linalg.inv(pose(0, 0, 3.0))
    assert estimate_pose(matches, K, faster) is None

    similar = np.linalg.inv(pose(0, 0, 1.2))
    estimated = estimate_pose(matches, K, similar)
    # Over 20 seeds, the largest error is 0.005 ± 0.003.
    np.testing.assert_allclose(estimated.T_now_before, forth, atol=0.017)


def test_the_last_motion_is_a_start_where_most_depths_are_wrong():
    forth = np.linalg.inv(pose(0.05, 0, 0.67))
    T_last = np.linalg.inv(pose(0.04, 0, 0.6))
    has_right_depth = np.arange(POINTS) < 8
    sigma = np.where(has_right_depth, 0.02, 1.0)
    found = {"alone": 0, "started": 0}
    for seed in range(40):
        rng = np.random.default_rng(seed)
        _, xyz = points(rng)
        xyz = 0.3 * xyz
        uv, _ = project(transform(forth, xyz), K)
        factors = np.where(has_right_depth, 1, np.exp(rng.normal(0, 1, POINTS)))
        matches = Matches(factors[:, None] * xyz, sigma, uv)

        alone = estimate_pose(matches, K)
        started = estimate_pose(matches, K, T_last)
        for name, estimated in (("alone", alone), ("started", started)):
            if estimated is not None:
                found[name] += np.abs(estimated.T_now_before - forth).max() < 0.01

    # Of 200 seeds, the motion is found with all, or with 65 alone: here with 13 ± 3 of 40.
    assert found["started"] == 40
    assert found["alone"] < 25


def test_each_cell_has_its_two_best_corners():
    """Cells at the right edge, too, and no cell shares its corners with another row's."""
    quality = np.random.default_rng(0).random((50, 70))
    expected = set()
    for top in range(0, 50, 20):
        for left in range(0, 70, 20):
            cell = quality[top : top + 20, left : left + 20]
            rows, columns = np.unravel_index(np.argsort(cell, axis=None)[-2:], cell.shape)
            expected |= {*zip((left + columns).tolist(), (top + rows).tolist(), strict=True)}
    picked = pick_corners(quality, cell_px=20, min_quality=0.1)
    assert sorted(map(tuple, picked.tolist())) == sorted(expected)


def test_noise_of_values_is_that_beside_a_steady_change():
    values = 2.0 * np.arange(20_000) + np.random.default_rng(0).normal(0, 0.3, 20_000)
    assert estimate_noise(values) == pytest.approx(0.3, rel=0.05)


@pytest.mark.parametrize("ahead_m", [0.0, 1.5])
@pytest.mark.parametrize("yaw_rate", [0.5, -0.5, 0.0])
def test_rates_are_those_of_the_axle_wherever_the_camera_is(yaw_rate, ahead_m):
    mount = np.eye(4)
    mount[2, 3] = ahead_m
    first, second = street.arc(2, yaw_rate, 6.0)
    rates = step.compute_rates(np.linalg.inv(first @ mount) @ second @ mount, 0.1)
    assert rates.yaw_rate_radps == pytest.approx(yaw_rate)
    assert rates.speed_mps == pytest.approx(6.0, rel=1e-3)  # the chord of the arc


def test_durations_average_jitter_of_the_past_and_follow_another_rate():
    """Times are on a grid of 10 ms, as KITTI's.

    After 60 frames, only every fourth is there, and at last the rate is halved.
    """
    frame = np.concatenate([np.arange(60), 60 + 4 * np.arange(20), 140 + np.arange(20)])
    exact_s = np.interp(frame, [0, 140, 160], [0, 140 * 0.1037, 140 * 0.1037 + 20 * 0.2074])
    time_s = np.round(exact_s, 2)
    duration_s = step.average_durations(frame, time_s)
    assert np.isnan(duration_s[0])
    assert duration_s[20:80] == pytest.approx(0.1037, rel=0.01)
    assert duration_s[82:] == pytest.approx(0.2074, rel=0.02)
    # Single differences are worse.
    assert np.abs(np.diff(time_s)[20:59] / 0.1037 - 1).max() > 0.03
    # They are causal.
    np.testing.assert_array_equal(
        step.average_durations(frame[:50], time_s[:50])[1:], duration_s[1:50]
    )


DT_S = 0.1


def views(*poses: np.ndarray) -> list[Frame]:
    return [Frame(number, number * DT_S, *street.view(pose)) for number, pose in enumerate(poses)]


def measured(
    frames: list[Frame], camera: Camera = street.WIDE.at_height(street.WIDE.height_m)
) -> list[step.Step | None]:
    """Return the steps to frames of a camera, whose height is known if it is not given."""
    odometry = Odometry(camera)
    return [odometry.measure_step(frame) for frame in frames]


def speeds(steps: list[step.Step | None]) -> list[float]:
    """Return the speeds of steps; all but the first must be measured."""
    assert steps[0] is None
    return [step.compute_rates(measured.T_before_now, DT_S).speed_mps for measured in steps[1:]]


def yaw_rates(steps: list[step.Step | None]) -> list[float]:
    """Return the yaw rates of steps; all but the first must be measured."""
    assert steps[0] is None
    return [
        step.compute_rates(measured.T_before_now, DT_S).yaw_rate_radps for measured in steps[1:]
    ]


def constant(value: float, count: int = 3, **tolerance: float) -> object:
    """Return what `count` values must be approximately equal to."""
    return pytest.approx([value] * count, **tolerance)


@pytest.mark.parametrize(
    ("yaw_rate", "speed"), [(0.4, 6.0), (-0.4, 6.0), (0.0, 12.0), (0.05, 1.0), (0.0, -2.0)]
)
def test_known_motion_is_measured(yaw_rate, speed):
    steps = measured(views(*street.arc(4, yaw_rate, speed)))
    # Over textures of 8 seeds, errors have a deviation of 0.0017 rad/s, and of 0.03 m/s or 0.5 %.
    assert yaw_rates(steps) == constant(yaw_rate, abs=0.007)
    assert speeds(steps) == constant(speed, rel=0.02, abs=0.12)


def test_motion_is_measured_since_the_frame_before_by_number():
    frames = views(*street.arc(6, 0.3, 6.0))
    steps = measured(frames[:3] + frames[4:])
    is_missing = [measured_step is None for measured_step in steps]
    assert is_missing == [True, False, False, True, False]


@pytest.mark.parametrize("road", [classes.ROAD, classes.CAR])
def test_a_wrong_scale_is_corrected_by_the_camera_height(road):
    """Also where the road has the class of cars, as shaded road of grey images."""
    frames = views(*street.arc(4, 0.2, 6.0))
    for frame in frames:
        frame.depth_m = 0.7 * frame.depth_m
        frame.cls = np.where(frame.cls == classes.ROAD, road, frame.cls)

    assert speeds(measured(frames)) == constant(6.0, rel=0.03)
    without_height = measured(frames, street.WIDE)
    assert speeds(without_height) == constant(0.7 * 6.0, rel=0.03)
    assert yaw_rates(without_height) == constant(0.2, abs=0.01)


@pytest.mark.parametrize("reflection", [0.0, 0.4])
def test_a_bonnet_is_left_out(reflection):
    """Its texture stays in place under the reflection of a scene that moves; depth is 3 m."""
    frames = views(*street.arc(5, 0.2, 6.0))
    bonnet = slice(82, 96)
    texture = np.random.default_rng(0).integers(0, 255, (14, 320, 1), dtype=np.uint8)
    for frame in frames:
        frame.image[bonnet] = (1 - reflection) * texture + reflection * frame.image[13::-1]
        frame.depth_m[bonnet] = 3.0
        frame.cls[bonnet] = classes.ROAD
    steps = measured(frames)
    # Over textures of 8 seeds, errors have a deviation of 1.1 % and 0.0025 rad/s.
    assert speeds(steps) == constant(6.0, 4, rel=0.05)
    assert yaw_rates(steps) == constant(0.2, 4, abs=0.012)


@pytest.mark.parametrize(("speed", "yaw_rate"), [(0.0, 0.0), (0.3, 0.0), (8.0, 0.0), (8.0, 0.3)])
def test_a_street_is_no_bonnet(speed, yaw_rate):
    """Neither while the car stands, in noise, nor when it turns or moves slowly."""
    rng = np.random.default_rng(0)
    images = []
    for T_world_cam in street.arc(4, yaw_rate, speed):
        image, _, _ = street.view(T_world_cam)
        noisy = image[..., 0] + rng.normal(0, 2, (96, 320))
        images.append(np.clip(noisy, 0, 255).astype(np.uint8))
    still = Still(street.WIDE)
    for before, now in pairwise(images):
        still.add_images(before, now, 0.0)
        assert not still.mask.any()


def test_traffic_is_excluded_by_its_class():
    """A bus ahead moves with the car and fills most of the view."""
    frames = views(*street.arc(3, 0.0, 6.0))
    bus = (slice(10, 80), slice(60, 260))
    texture = np.random.default_rng(0).integers(0, 255, (70, 200, 1), dtype=np.uint8)
    for frame in frames:
        frame.image[bus] = texture
        frame.depth_m[bus] = 8.0
        frame.cls[bus] = classes.BUS
    assert speeds(measured(frames)) == constant(6.0, 2, rel=0.05)

    # With another class, it hides the motion of the street, with 7 of 8 textures in a step or both.
    for frame in frames:
        frame.cls[bus] = classes.BUILDING
    assert None in measured(frames)[1:]


# The summary of a drive by day at 10 images per second.
HEALTHY = {
    "frames": 100,
    "valid": 98,
    "moving": 99,
    "backwards": 0,
    "step_s": 0.104,
    "step_m": 0.9,
    "scatter": 0.03,
    "scale_sigma": 0.07,
    "road_frames": 99,
    "moving_road_frames": 98,
    "road_height_m": 1.62,
    "camera_height_m": 1.65,
    "scaled": 1,
    "unit_error": 1.8,
    "contradiction_s": 0.0,
}
# The same of a drive in which nothing moves and no road is seen.
STANDING = HEALTHY | dict.fromkeys(["valid", "moving", "moving_road_frames", "road_frames"], 0)
STANDING |= dict.fromkeys(["step_s", "step_m", "scatter", "road_height_m"], 0.0)


def test_facts_are_sums_and_medians_of_drives():
    (line,) = facts_lines({"1": HEALTHY, "2": HEALTHY | {"road_height_m": 1.66}})
    assert "measured in 196 of 198 moving frames" in line
    assert "a road in 196 of them, by depth 1.64 m below the camera (known: 1.65 m)" in line
    assert "(the scale is not known)" in facts_line("1", [HEALTHY | {"scaled": 0}])

    # Unknown values are printed as such, and have no part in a median.
    assert "by depth – m below" in facts_line("standing", [STANDING])
    assert "; – s and – m per step; the speed scatters by – " in facts_line("1", [STANDING])
    assert "; 0.10 s and 0.90 m per step;" in facts_line("1", [STANDING, STANDING, HEALTHY])


@pytest.mark.parametrize(
    ("changes", "doubted"),
    [
        ({"valid": 89}, True),
        ({"scatter": 0.081}, True),
        ({"backwards": 49}, False),
        ({"backwards": 50}, True),
        ({"frames": 9, "moving": 9, "valid": 0}, False),
        ({"frames": 40, "moving": 39, "valid": 32, "moving_road_frames": 39}, False),
        ({"moving_road_frames": 50}, False),
        ({"moving_road_frames": 49}, True),
        ({"road_height_m": 1.65 * 0.71}, False),
        ({"road_height_m": 1.65 * 0.69}, True),
        ({"road_height_m": 1.65 * 1.39}, False),
        ({"road_height_m": 1.65 * 1.41}, True),
        ({"road_height_m": 1.65 * 1.41, "scaled": 0}, False),
        ({"contradiction_s": 0.9}, False),
        ({"contradiction_s": 1.0}, True),
    ],
)
def test_a_drive_is_doubted_if_its_motion_is_not_well_measured(changes, doubted):
    *doubts, line = facts_lines({"healthy": HEALTHY, "other": HEALTHY | changes})
    assert [doubt.split(":")[:2] for doubt in doubts] == [["doubt", " motion of other"]] * doubted
    assert line.startswith("motion of all drives")


@pytest.mark.parametrize(("ratio", "refused"), [(1.1, False), (3.9, True), (0.5, True)])
def test_depth_in_another_unit_is_refused(ratio, refused):
    """By the road of many frames, of one drive or of several."""
    drive = HEALTHY | {"road_height_m": 1.65 * ratio, "road_frames": 30}
    # One drive has too few frames, the other an encoder with random weights.
    check_unit({"1": drive})
    check_unit({"1": drive | {"unit_error": 0.0, "road_frames": 300}})
    two_short = {"1": drive, "2": drive}
    one_long = {"1": HEALTHY, "2": HEALTHY, "3": drive | {"road_frames": 50}}
    for drives in (two_short, one_long):
        expected = nullcontext()
        if refused:
            expected = pytest.raises(InputError, match=f"road is {ratio:.2f} times")
        with expected:
            check_unit(drives)


def test_a_black_image_shows_no_road():
    """Also where depth is that of a road."""
    frames = views(*street.arc(2, 0.0, 6.0))
    odometry = Odometry(street.WIDE)
    odometry.measure_step(frames[0])
    assert odometry.road.frame_height_m > 0
    odometry.measure_step(replace(frames[1], image=np.zeros_like(frames[1].image)))
    assert odometry.road.frame_height_m == 0


def test_images_upside_down_are_refused():
    images = [street.view(pose)[0] for pose in street.arc(60, 0.0, 8.0)]
    upright = horizon.HeadingFinder(street.WIDE)
    upside_down = horizon.HeadingFinder(street.WIDE)
    for image in images * 2:
        upright.add_image(image)
        upside_down.add_image(image[::-1, ::-1].copy())
    assert horizon.compute_horizon(upright.headings, street.WIDE) is not None
    with pytest.raises(InputError, match="images are upside down"):
        horizon.compute_horizon(upside_down.headings, street.WIDE)
