"""The path ahead against a simulated drive, whose heading is a known function of the distance."""

from collections.abc import Callable

import numpy as np
import pytest

from pipeline.labels import ahead
from pipeline.labels.label import Labels

EDGES_M = [0, 5, 10, 20, 30]
Function = Callable[[np.ndarray], np.ndarray]


def drive(
    speed: Function, curvature: Function = lambda s: np.full_like(s, 0.02), seconds: float = 8.0, hz: float = 10.0
) -> tuple[np.ndarray, Labels, np.ndarray]:
    """Return times, labels and true distances of a drive with `speed`(t) on a road with `curvature`(distance)."""
    fine_s = np.arange(0, seconds, 1e-4)
    distance = np.cumsum(speed(fine_s)) * 1e-4
    time_s = np.arange(0, seconds - 1e-3, 1 / hz)
    at_m, speed_mps = np.interp(time_s, fine_s, distance), speed(time_s)
    unused = np.zeros(len(time_s))
    return time_s, Labels(unused, unused.astype(bool), speed_mps, speed_mps * curvature(at_m)), at_m


def compute(
    time_s: np.ndarray,
    labels: Labels,
    max_stand_s: float = 5.0,
    frame: np.ndarray | None = None,
    **changes: np.ndarray,
) -> ahead.Ahead:
    frame = np.arange(len(time_s)) if frame is None else frame
    return ahead.path_ahead(frame, time_s, labels._replace(**changes), EDGES_M, max_stand_s)


def constant(value: float) -> Function:
    return lambda t: np.full_like(t, value)


def test_a_circle_has_the_curvature_of_its_radius_until_the_drive_ends() -> None:
    time_s, labels, at_m = drive(constant(9.3))
    curvature, valid = compute(time_s, labels)
    np.testing.assert_allclose(curvature[valid], 0.02, rtol=1e-9)
    expected = at_m[:, None] + np.array(EDGES_M[1:]) <= at_m[-1] + 1e-6
    assert (valid != expected).sum() <= len(EDGES_M) - 1  # where an edge falls on the last frame up to rounding
    assert not curvature[~valid].any()


@pytest.mark.parametrize("hz", [10.0, 4.0])
def test_a_clothoid_has_the_curvature_of_the_middle_of_each_range(hz: float) -> None:
    """Second route: the mean of a linear function is its value in the middle; the speed varies on the way."""
    time_s, labels, at_m = drive(lambda t: 8 + 4 * np.sin(t), lambda s: 0.001 * s - 0.03, hz=hz)
    curvature, valid = compute(time_s, labels)
    middle = at_m[:, None] + np.array([2.5, 7.5, 15, 25])
    np.testing.assert_allclose(curvature[valid], (0.001 * middle - 0.03)[valid], atol=2e-4 * (10 / hz) ** 2)
    assert (curvature[valid] < 0).any()
    assert (curvature[valid] > 0).any()


def test_an_s_bend_is_integrated_over_each_range() -> None:
    time_s, labels, at_m = drive(constant(9.0), lambda s: 0.05 * np.sin(s / 6))
    curvature, valid = compute(time_s, labels)
    edges = at_m[:, None] + EDGES_M
    expected = -np.diff(0.3 * np.cos(edges / 6), axis=1) / np.diff(EDGES_M)
    np.testing.assert_allclose(curvature[valid], expected[valid], atol=3e-4)


def stop(t: np.ndarray) -> np.ndarray:
    """Brake to a stand from second 3 to 7 and drive on; sensors at standstill have noise of either sign."""
    speed = np.interp(t, [0, 1, 3, 7, 9], [8.0, 8, 0, 0, 8])
    return np.where((t >= 3) & (t <= 7), 0.1 * np.sin(20 * t), speed)


def test_a_stop_on_the_way_neither_turns_nor_moves_the_car() -> None:
    time_s, labels, _ = drive(stop, seconds=16)
    standing = (time_s >= 3) & (time_s <= 7)
    labels.yaw_rate_radps[standing] = 0.003
    curvature, valid = compute(time_s, labels)
    assert valid[:50].all()
    np.testing.assert_allclose(curvature[valid], 0.02, rtol=0.1)


def test_a_long_stop_on_the_way_is_no_label() -> None:
    """It lasts 4 s; only the ranges that end beyond it are affected, and frames in its last seconds are not."""
    time_s, labels, at_m = drive(stop, seconds=16)
    _, valid = compute(time_s, labels, max_stand_s=2.0)
    beyond = at_m[:, None] + np.array(EDGES_M[1:]) > np.interp(7.0, time_s, at_m)
    before = time_s < 3
    np.testing.assert_array_equal(valid[before], ~beyond[before])
    assert not valid[(time_s > 3) & (time_s < 4.8)].any()
    assert valid[(time_s > 5.2) & (time_s < 10)].all()


@pytest.mark.parametrize("speed", [0.0, 3.0])
def test_a_drive_shorter_than_the_nearest_range_has_no_label(speed: float) -> None:
    time_s, labels, _ = drive(constant(speed), seconds=1.5)
    curvature, valid = compute(time_s, labels)
    assert curvature.shape == valid.shape == (15, 4)
    assert not valid.any()
    assert not curvature.any()


def test_a_drive_of_25_m_has_no_label_in_the_last_range() -> None:
    time_s, labels, _ = drive(constant(10.0), seconds=2.51)
    _, valid = compute(time_s, labels)
    assert valid[0].tolist() == [True, True, True, False]


def test_no_path_passes_a_reversing_a_missing_or_an_unmeasured_frame() -> None:
    time_s, labels, at_m = drive(constant(9.3))
    _, complete = compute(time_s, labels)
    far = at_m[:, None] + np.array(EDGES_M[1:])
    speed, yaw_rate, frame = labels.speed_mps.copy(), labels.yaw_rate_radps.copy(), np.arange(len(time_s))
    speed[40], yaw_rate[40], frame[40:] = -1.0, np.nan, frame[40:] + 1
    unknown = labels.speed_mps.copy()
    unknown[40] = np.nan
    for last_row, changes in (
        (39, {"speed_mps": speed}),
        (39, {"yaw_rate_radps": yaw_rate}),
        (39, {"speed_mps": unknown}),
        (39, {"frame": frame}),
    ):
        curvature, valid = compute(time_s, labels, **changes)
        np.testing.assert_array_equal(valid[:40], far[:40] <= at_m[last_row] + 1e-9)
        np.testing.assert_array_equal(valid[41:], complete[41:])
        assert "frame" in changes or not valid[40].any()
        assert np.isfinite(curvature).all()


def test_no_frames() -> None:
    none = np.zeros(0)
    curvature, valid = compute(none, Labels(none, none.astype(bool), none, none))
    assert curvature.shape == valid.shape == (0, 4)


def test_mirrored_motion_gives_the_mirrored_path() -> None:
    rng = np.random.default_rng(0)
    time_s, speed, yaw_rate = np.cumsum(rng.uniform(0.08, 0.12, 80)), rng.uniform(0, 12, 80), rng.normal(0, 0.2, 80)
    labels = Labels(speed, speed > 0, speed, yaw_rate)
    left, right = compute(time_s, labels), compute(time_s, labels, yaw_rate_radps=-yaw_rate)
    np.testing.assert_array_equal(left.valid, right.valid)
    np.testing.assert_allclose(left.curvature_1pm, -right.curvature_1pm, atol=1e-15)
