"""Speeds and their uncertainty, by lengths of steps and by their ratios."""

import numpy as np
import pytest

from pipeline.camera.camera import Frame
from pipeline.camera.geometry import project, transform
from pipeline.motion.measure import find_jumps
from pipeline.motion.odometry import Odometry
from pipeline.motion.speed import TYPICAL_MPS, Speeds, filter_speeds, smooth_speeds
from pipeline.motion.triangulation import RATIO_NOISE, Tracks, compare_lengths, find_tracks
from tests import street
from tests.street import pose

COUNT = 900
TIME_S = np.arange(COUNT) / 10
K = street.WIDE.K


def measured(speed_mps: np.ndarray, road: bool = True, ratio: np.ndarray | None = None) -> Speeds:
    """Return speeds that were measured at 10 Hz; `ratio`: to the step before."""
    count = len(speed_mps)
    if ratio is None:
        ratio = np.zeros(count)
    sigma = np.full(count, RATIO_NOISE)
    return Speeds(TIME_S[:count], speed_mps, np.full(count, road), ratio, sigma)


def slow_noise(rng: np.random.Generator, sigma: float, keep: float) -> np.ndarray:
    """Return noise [COUNT] of which a share `keep` is that of the step before."""
    noise = np.zeros(COUNT)
    for row in range(1, COUNT):
        noise[row] = keep * noise[row - 1] + rng.normal(0, sigma * np.sqrt(1 - keep**2))
    return noise


def braking() -> np.ndarray:
    """Return a speed from 12 m/s to 1.5 m/s in 6 s, and back, as of a car in traffic."""
    return 6.75 + 5.25 * np.cos(TIME_S * np.pi / 6)


def test_with_a_road_a_car_may_reverse_and_stand():
    estimate = filter_speeds(measured(np.array([-2.0] * 20 + [0.0] * 5)))
    assert estimate.speed_mps[10:20] == pytest.approx([-2.0] * 10, rel=0.05)
    assert (estimate.speed_mps[20:] == 0).all()
    # The error of depth's scale, and that of a length by depth.
    assert estimate.sigma[15] == pytest.approx(np.hypot(0.025, 0.04), rel=0.1)


def test_without_a_road_the_scale_of_depth_is_not_believed():
    """Depth makes bends slow, as with a lens of 17 degrees. It must not make them sharp."""
    error = slow_noise(np.random.default_rng(0), 0.6, 0.96)
    estimate = filter_speeds(measured(14.0 * np.exp(error), road=False))
    assert np.log(estimate.speed_mps).std() < 0.2 < error.std()
    assert np.median(estimate.sigma) == pytest.approx(0.4, abs=0.05)  # that of the speed in a drive
    assert np.median(estimate.speed_mps) == pytest.approx(TYPICAL_MPS, rel=0.4)


@pytest.mark.parametrize(("spread", "gain"), [(0.03, 0.85), (0.08, 0.58)])
def test_ratios_reduce_the_errors_of_depth_and_sigma_tells_what_is_left(spread, gain):
    """Depth errs for a second, in some drives more than in others."""
    true_mps = braking()
    known = slice(100, None)  # the spread is learned
    squared = {"filter": [], "smooth": []}
    in_sigmas = {"filter": [], "smooth": []}
    for seed in range(6):
        rng = np.random.default_rng(seed)
        by_depth = true_mps * np.exp(slow_noise(rng, spread, np.exp(-0.1)))
        ratio = np.append(0, true_mps[1:] / true_mps[:-1])
        ratio *= np.exp(rng.normal(0, RATIO_NOISE, COUNT))
        speeds = measured(by_depth, ratio=ratio)
        for name, estimate in {
            "filter": filter_speeds(speeds),
            "smooth": smooth_speeds(speeds),
        }.items():
            error = np.log(estimate.speed_mps / true_mps)[known]
            squared[name].append(error**2)
            in_sigmas[name].append((error / estimate.sigma[known]) ** 2)

    # Over groups of six seeds, errors have a deviation of 5 %; in sigmas, they are 0.7 to 1.0 with
    # a deviation of 0.04 to 0.07.
    filtered = np.sqrt(np.mean(squared["filter"]))
    smoothed = np.sqrt(np.mean(squared["smooth"]))
    assert filtered == pytest.approx(gain * spread, rel=0.2)
    assert smoothed < 0.95 * filtered
    for values in in_sigmas.values():
        assert 0.55 < np.sqrt(np.mean(values)) < 1.3


def test_a_ratio_that_contradicts_depth_is_not_used():
    """After lost images, a ratio may be that to a step of another length."""
    ratio = np.append(0, np.ones(99))
    for wrong in (0.25, 0.5, 0.8, 1.25, 2.0, 4.0):
        ratio[50] = wrong
        speeds = measured(np.full(100, 8.0), ratio=ratio)
        for estimate in (filter_speeds(speeds), smooth_speeds(speeds)):
            assert estimate.speed_mps[40:] == pytest.approx(8.0, rel=0.02), wrong


def steps(*lengths_m: float) -> list[np.ndarray]:
    """Return the poses of a camera that moves ahead, and a little to the right, by lengths."""
    places_m = np.concatenate([[0.0], np.cumsum(lengths_m)])
    return [pose(0.01 * number, 0.05 * z, z) for number, z in enumerate(places_m)]


def test_the_ratio_of_two_steps_needs_no_depth_and_bears_outliers():
    rng = np.random.default_rng(0)
    first, second, third = steps(1.0, 1.3)
    xyz = rng.uniform([4, -3, 8], [10, 1.5, 25], (200, 3))
    xyz[::2, 0] *= -1
    uv = [project(transform(np.linalg.inv(T), xyz), K)[0] for T in (first, second, third)]
    tracks = find_tracks(uv[0], uv[1], np.linalg.inv(first) @ second, K)
    step = np.linalg.inv(second) @ third
    exact = compare_lengths(tracks, uv[2], step, K)
    assert len(tracks.uv) == 200
    assert exact.value == pytest.approx(1.3, rel=1e-3)
    assert exact.sigma == pytest.approx(RATIO_NOISE, rel=0.01)

    moved = uv[2] + rng.normal(0, 0.3, uv[2].shape)
    moved[::5] += 3
    noisy = compare_lengths(tracks, moved, step, K)
    assert noisy.value == pytest.approx(1.3, rel=0.02)
    assert noisy.sigma > RATIO_NOISE

    few = Tracks(*(column[:10] for column in tracks))
    assert compare_lengths(few, uv[2][:10], step, K).value == 0


def test_odometry_compares_each_step_with_the_one_before():
    camera = street.WIDE.at_height(street.WIDE.height_m)
    odometry = Odometry(camera)
    lengths_m = [0.8, 0.8, 1.0, 1.0, 0.7]
    poses = [pose(0, 0, z) for z in np.concatenate([[0.0], np.cumsum(lengths_m)])]
    ratios = []
    for number, T in enumerate(poses):
        step = odometry.measure_step(Frame(number, number / 10, *street.view(T)))
        ratios.append(step.ratio if step else 0.0)
    assert ratios[:2] == [0, 0]
    assert ratios[2:] == pytest.approx([1.0, 1.25, 1.0, 0.7], rel=0.03)


def test_a_speed_that_no_car_reaches_is_no_measurement():
    """From 6 to 1 m/s in a step, and back; but braking, and a start after a pause, are motion."""
    speed_mps = np.array([6.0, 6.1, 1.0, 6.0, 5.2, 4.4, 0.3, 8.0, 8.1])
    time_s = np.array([0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.9, 2.9, 3.0])
    valid = np.ones(9, bool)
    valid[6] = False
    assert np.flatnonzero(find_jumps(time_s, speed_mps, valid)).tolist() == [2]
