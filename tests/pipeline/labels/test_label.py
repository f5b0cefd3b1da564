"""The steering label and paths."""

from collections.abc import Callable

import numpy as np
import pytest

from pipeline.labels import label

L = 2.7


def labels(yaw_rate: list[float], speed: list[float], standstill: label.Standstill) -> tuple[np.ndarray, np.ndarray]:
    return label.steering_labels(
        np.array(yaw_rate), np.array(speed), wheelbase_m=L, min_speed_mps=1.0, standstill=standstill
    )


def test_left_bend_is_positive_with_the_bicycles_radius() -> None:
    speed, radius = 8.0, 20.0
    angle = label.steering_angle(np.array([speed / radius, -speed / radius]), np.array([speed, speed]), L)
    np.testing.assert_allclose(np.tan(angle), [L / radius, -L / radius])


def test_reversing_with_the_wheels_to_the_left_is_positive_too() -> None:
    """In reverse along the same circle, v and the yaw rate change sign; the wheel angle does not."""
    forwards = label.steering_angle(np.array([0.3]), np.array([4.0]), L)
    backwards = label.steering_angle(np.array([-0.3]), np.array([-4.0]), L)
    np.testing.assert_array_equal(forwards, backwards)
    assert forwards > 0


def test_standstill_rules() -> None:
    yaw_rate, speed = [0.1, 0.1, -0.01, -0.1, 0.0], [5.0, 1.0, 0.02, -3.0, 0.0]
    formula = [*np.arctan(L * np.array(yaw_rate[:4]) / np.array(speed[:4])).tolist(), 0.0]
    for rule, expected, valid in (
        ("invalid", formula, [1, 1, 0, 1, 0]),
        ("raw", formula, [1, 1, 1, 1, 1]),
        ("zero", [formula[0], formula[1], 0.0, formula[3], 0.0], [1, 1, 1, 1, 1]),
    ):
        angle, usable = labels(yaw_rate, speed, rule)  # type: ignore[arg-type]
        np.testing.assert_allclose(angle, expected, atol=1e-15, err_msg=rule)
        np.testing.assert_array_equal(usable, valid, err_msg=rule)


def test_mirrored_motion_gives_the_mirrored_label() -> None:
    rng = np.random.default_rng(0)
    yaw_rate, speed = rng.normal(0, 0.2, 100), rng.normal(3, 3, 100)
    angle, valid = labels(yaw_rate.tolist(), speed.tolist(), "invalid")
    mirrored, same = labels((-yaw_rate).tolist(), speed.tolist(), "invalid")
    np.testing.assert_array_equal(mirrored, -angle)
    np.testing.assert_array_equal(same, valid)


def test_constant_steering_drives_a_circle() -> None:
    """After a full circle the car is back; halfway it is 2R to the left of its start."""
    radius, speed, frames = 12.0, 6.0, 2001
    time_s = np.linspace(0, 2 * np.pi * radius / speed, frames)
    angle = np.full(frames, np.arctan(L / radius))
    xy = label.path(angle, np.full(frames, speed), time_s, wheelbase_m=L)
    np.testing.assert_allclose(xy[-1], [0, 0], atol=1e-3)
    np.testing.assert_allclose(xy[frames // 2], [0, 2 * radius], atol=1e-3)


@pytest.mark.parametrize("model", ["bicycle", "paper"])
def test_mirrored_steering_drives_the_mirrored_path(model: str) -> None:
    rng = np.random.default_rng(0)
    angle, speed, time_s = rng.normal(0, 0.2, 30), rng.uniform(0, 10, 30), np.cumsum(rng.uniform(0.08, 0.12, 30))
    path: Callable[..., np.ndarray] = label.path
    left, right = (path(sign * angle, speed, time_s, wheelbase_m=L, model=model) for sign in (1, -1))
    np.testing.assert_allclose(left * [1, -1], right, atol=1e-12)


def test_paper_model_is_its_formula() -> None:
    """With constant steering the paper's path is a straight line, as the angle is the heading."""
    time_s = np.array([0.0, 0.1, 0.3])
    xy = label.path(np.full(3, 0.2), np.array([5.0, 10.0, 0.0]), time_s, wheelbase_m=L, model="paper")
    distance = np.array([0.0, 0.5, 2.5])
    np.testing.assert_allclose(xy, distance[:, None] * [np.cos(0.2), np.sin(0.2)])


def test_measured_angle_repeats_where_motion_is_unusable() -> None:
    yaw_rate, speed = np.array([9.0, 0.3, 9.0, 0.5, -0.2]), np.array([9.0, 6.0, 6.0, 0.4, -3.0])
    valid = np.array([0, 1, 0, 1, 1], np.uint8)
    angle = label.measured_angle(yaw_rate.astype(np.float32), speed.astype(np.float32), valid, 2.7, 1.0)
    left, reverse = np.arctan(2.7 * 0.3 / 6), np.arctan(2.7 * 0.2 / 3)
    assert angle.dtype == np.float64
    assert angle == pytest.approx([0, left, left, left, reverse], rel=1e-6)
    assert label.measured_angle(speed, speed, np.zeros(5), 2.7, 1.0).tolist() == [0] * 5
    assert label.measured_angle(speed[:0], speed[:0], valid[:0], 2.7, 1.0).shape == (0,)
