"""Test the steering label, paths, the path ahead, and means of rates."""

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.labels import ahead, label
from pipeline.labels.label_file import Labels
from pipeline.motion.rates import REACH, YAW_SIGMA_S, gaussian_mean

L = 2.7
CAR = label.Car(L, 1.0)
EDGES_M = [0, 5, 10, 20, 30]
Function = Callable[[np.ndarray], np.ndarray]
SPEED = st.floats(0.5, 30.0)


@given(radius=st.floats(4, 1e3), speed=SPEED)
def test_a_left_bend_is_positive_with_the_bicycles_radius_and_in_reverse_too(radius, speed):
    yaw_rates = np.array([1, -1, -1]) * speed / radius
    speeds = np.array([1, 1, -1]) * speed
    tangents = np.tan(label.steering_angle(yaw_rates, speeds, L))
    np.testing.assert_allclose(tangents, np.array([1, -1, 1]) * L / radius)


def test_measured_angle_repeats_where_motion_is_unusable():
    yaw_rate = np.array([9.0, 0.3, 9.0, 0.5, -0.2])
    speed = np.array([9.0, 6.0, 6.0, 0.4, -3.0])
    angle = label.measured_angle(yaw_rate, speed, np.array([0, 1, 0, 1, 1]), CAR)
    left = np.arctan(L * 0.3 / 6)
    reverse = np.arctan(L * 0.2 / 3)
    assert angle == pytest.approx([np.nan, left, left, left, reverse], nan_ok=True)


def test_unknown_and_slow_motion_give_no_valid_label():
    """The angle is 0 where speed or yaw rate is unknown. The least speed itself is fast enough."""
    speed = np.array([np.nan, 0.9, 1.0, -1.0, 9.0, np.nan])
    labels = label.steering_labels(np.array([np.nan, 0.1, 0.1, 0.1, np.nan, 0.1]), speed, CAR)
    assert labels.valid.tolist() == [False, False, True, True, False, False]
    assert labels.steering_rad[[0, 4, 5]].tolist() == [0, 0, 0]
    assert labels.steering_rad[2] == pytest.approx(np.arctan(L * 0.1))


def circle(distance_m: np.ndarray) -> np.ndarray:
    return np.full_like(distance_m, 0.02)


def drive(
    speed: Function, curvature: Function = circle, seconds: float = 8.0
) -> tuple[np.ndarray, Labels, np.ndarray]:
    """Return times, labels and distances of a drive with `speed`(t) and `curvature`(distance)."""
    fine_s = np.arange(0, seconds, 1e-4)
    distance = np.cumsum(np.maximum(speed(fine_s), 0)) * 1e-4
    time_s = np.arange(0, seconds - 1e-3, 0.1)
    distance_m = np.interp(time_s, fine_s, distance)
    speed_mps = speed(time_s)
    unused = np.zeros(len(time_s))
    yaw_rate_radps = speed_mps * curvature(distance_m)
    return time_s, Labels(unused, unused.astype(bool), speed_mps, yaw_rate_radps), distance_m


def compute(
    time_s: np.ndarray, labels: Labels, stand_s: float = 5, frame: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    if frame is None:
        frame = np.arange(len(time_s))
    return ahead.path_ahead(frame, time_s, labels, EDGES_M, stand_s)


@pytest.mark.parametrize(
    ("speed", "curvature", "integral"),
    [
        (lambda t: np.full_like(t, 9.3), circle, lambda s: 0.02 * s),
        (
            lambda t: 8 + 4 * np.sin(t),
            lambda s: 0.001 * s - 0.03,
            lambda s: 0.0005 * s**2 - 0.03 * s,
        ),
    ],
    ids=["circle", "clothoid"],
)
def test_the_path_ahead_is_the_mean_curvature_of_each_range(speed, curvature, integral):
    """The path is valid until the drive ends; the heading is known by the distance, too."""
    time_s, labels, distance_m = drive(speed, curvature)
    ahead_1pm, valid = compute(time_s, labels)
    edges = distance_m[:, None] + EDGES_M
    expected = np.diff(integral(edges), axis=1) / np.diff(EDGES_M)
    np.testing.assert_allclose(ahead_1pm[valid], expected[valid], atol=3e-4)
    assert valid.any()
    assert not ahead_1pm[~valid].any()
    # The drive may end on an edge, but for rounding.
    driven = edges[:, 1:] <= distance_m[-1] + 1e-6
    assert (valid != driven).sum() < len(EDGES_M)


def stop(t: np.ndarray, noise: Function) -> np.ndarray:
    """Brake to a stand from second 3 to 7, where speeds are the noise of a sensor, and go on."""
    speed = np.interp(t, [0, 1, 3, 7, 9], [8.0, 8, 0, 0, 8])
    return np.where((t >= 3) & (t <= 7), noise(t), speed)


@pytest.mark.parametrize(
    "noise",
    [lambda t: 0.1 * np.sin(20 * t), lambda t: np.full_like(t, -0.15)],
    ids=["either sign", "as in KITTI"],
)
def test_a_stop_on_the_way_neither_turns_nor_moves_the_car_and_a_long_one_is_no_label(noise):
    """Only the ranges that end beyond it are affected, and frames in its last seconds are not."""
    time_s, labels, distance_m = drive(lambda t: stop(t, noise), seconds=16)
    labels.yaw_rate_radps[(time_s >= 3) & (time_s <= 7)] = 0.003
    curvature, valid = compute(time_s, labels)
    assert valid[:50].all()
    np.testing.assert_allclose(curvature[valid], 0.02, rtol=0.1)
    _, valid = compute(time_s, labels, stand_s=2.0)
    far_edges = distance_m[:, None] + np.array(EDGES_M[1:])
    beyond = far_edges > np.interp(7.0, time_s, distance_m)
    np.testing.assert_array_equal(valid[time_s < 3], ~beyond[time_s < 3])
    assert not valid[(time_s > 3) & (time_s < 4.8)].any()
    assert valid[(time_s > 5.2) & (time_s < 10)].all()


@pytest.mark.parametrize(
    "change", ["reverses", "yaw rate unknown", "speed unknown", "frame missing"]
)
def test_no_path_passes_a_reversing_a_missing_or_an_unmeasured_frame(change):
    time_s, labels, distance_m = drive(lambda t: np.full_like(t, 9.3))
    _, complete = compute(time_s, labels)
    frame = np.arange(len(time_s))
    if change == "frame missing":
        frame[40:] += 1
    elif change == "yaw rate unknown":
        labels.yaw_rate_radps[40] = np.nan
    elif change == "speed unknown":
        labels.speed_mps[40] = np.nan
    else:
        labels.speed_mps[40] = -1.0
    curvature, valid = compute(time_s, labels, frame=frame)
    far_edges = distance_m[:40, None] + EDGES_M[1:]
    np.testing.assert_array_equal(valid[:40], far_edges <= distance_m[39] + 1e-9)
    np.testing.assert_array_equal(valid[41:], complete[41:])
    assert np.isfinite(curvature).all()


@given(st.lists(st.floats(0.05, 3.0), min_size=1, max_size=30), st.integers(0, 2**32 - 1))
def test_yaw_rates_are_gaussian_means(steps_s, seed):
    time_s = np.cumsum(steps_s)
    yaw_rate = np.random.default_rng(seed).normal(0, 0.3, len(time_s))
    means, _ = gaussian_mean(time_s, yaw_rate, YAW_SIGMA_S)
    for mean, at_s in zip(means, time_s, strict=True):
        near = np.abs(time_s - at_s) <= REACH * YAW_SIGMA_S
        weights = np.exp(-(((time_s - at_s)[near] / YAW_SIGMA_S) ** 2) / 2)
        expected = np.average(yaw_rate[near], weights=weights)
        np.testing.assert_allclose(mean, expected, atol=1e-12)
