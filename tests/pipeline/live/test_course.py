"""Courses: speed where the road gives the scale and where nothing does, and the uncertainty of the angle."""

from collections.abc import Generator

import numpy as np
import pytest

from pipeline.labels.label import Car
from pipeline.live.chain import Estimate, FrameState
from pipeline.live.course import TYPICAL_MPS, SpeedFilter, add_courses
from pipeline.motion.step import Step

YAW_RATE_RADPS, COUNT = 0.2, 900


def frames(speed_mps: np.ndarray, yaw_rate_radps: np.ndarray, road: bool) -> Generator[FrameState]:
    for number, rates in enumerate(zip(yaw_rate_radps.tolist(), speed_mps.tolist(), strict=True)):
        estimate = Estimate(Step(np.eye(4), 100, 0.5), *rates)
        yield FrameState(number, number / 10, estimates={"visual": estimate}, road_height_m=1.6 if road else np.nan)


def course(speed_mps: np.ndarray, road: bool, height_known: bool = True, yaw_noise: float = 0.0) -> np.ndarray:
    """Return speed, yaw rate, angle, sigma of speed and of the angle for each frame [F,5]."""
    yaw_rate_radps = YAW_RATE_RADPS + np.random.default_rng(0).normal(0, yaw_noise, len(speed_mps))
    measured = add_courses(
        frames(speed_mps, yaw_rate_radps, road), Car(2.7, 1.0), smooth=True, height_known=height_known
    )
    courses = [frame.course for frame in measured if frame.course]
    return np.array([(*row[:2], row.steering_rad, row.speed_sigma, row.steering_sigma_rad) for row in courses], float)


def test_with_a_road_speed_is_that_of_the_images() -> None:
    """From 12 m/s to 1.5 m/s in 6 s, and back: as hard as a car brakes in traffic."""
    seconds = np.arange(COUNT) / 10
    true_mps = 6.75 + 5.25 * np.cos(seconds * np.pi / 6)
    speed_mps = course(true_mps, road=True)[:, 0]
    assert np.abs(speed_mps - true_mps).max() < 0.3  # of the Gaussian mean alone: 0.2


def test_without_a_road_the_scale_of_depth_is_not_believed() -> None:
    """Depth that makes bends slow, as measured with a lens of 17 degrees, must not make them sharp."""
    rng = np.random.default_rng(0)
    error = np.zeros(COUNT)
    for row in range(1, COUNT):
        error[row] = 0.96 * error[row - 1] + rng.normal(0, 0.6 * np.sqrt(1 - 0.96**2))
    measured_mps = 14.0 * np.exp(error)
    with_road, without = course(measured_mps, road=True), course(measured_mps, road=False)
    spread = [np.log(rows[:, 2]).std() for rows in (with_road, without)]
    assert spread[0] > 0.35
    assert spread[1] < 0.2
    assert np.median(without[:, 3]) > 0.25  # the relative sigma of speed admits it
    assert np.median(with_road[:, 3]) < 0.1
    assert np.median(without[:, 0]) == pytest.approx(TYPICAL_MPS, rel=0.4)


def test_an_unknown_camera_height_is_part_of_the_uncertainty() -> None:
    speed_mps = np.full(100, 8.0)
    known, unknown = (course(speed_mps, road=True, height_known=height)[:, 3] for height in (True, False))
    assert known.max() < 0.1
    assert (unknown >= 0.2).all()


def test_the_angles_sigma_covers_its_error() -> None:
    rows = course(np.full(COUNT, 8.0), road=True, yaw_noise=0.05)
    error_rad = rows[:, 2] - np.arctan(2.7 * YAW_RATE_RADPS / 8.0)
    covered = np.abs(error_rad) < 2 * rows[:, 4]
    assert covered.mean() > 0.9
    assert rows[:, 4].mean() < 4 * error_rad.std()


def test_reversing_and_standing_keep_sign_and_zero() -> None:
    speed = SpeedFilter()
    speeds = [speed.add(number / 10, mps, True, 0.02)[0] for number, mps in enumerate([-2.0] * 20 + [0.0] * 5)]
    assert speeds[10:20] == pytest.approx([-2.0] * 10, rel=0.05)
    assert speeds[20:] == [0.0] * 5
