"""Estimate the car's speed and its uncertainty from measured steps.

A step's length comes from depth, whose errors last: a network that sees a stretch of road too far
away does so in the next frames, too. Relative to the step before, a length is known ten times
better, by points that are seen in three frames. A Kalman filter combines both.
"""

import math
from typing import NamedTuple

import numpy as np

# Typical speed in m/s: the geometric mean of the medians of KITTI's 55 drives above 1.5 m/s.
TYPICAL_MPS = 8.4
# Standard deviation of the logarithm of the speed in one of these drives.
SPREAD = 0.4
# Correlation time in seconds of the logarithm of the speed in one of these drives.
SPREAD_S = 20.0
# Standard deviation of the logarithm of depth's scale if all recent frames show a road.
ROAD_SCALE = 0.025
# Standard deviation of the logarithm of depth's scale if no recent frame shows a road. A network
# takes a lens of 17 degrees for KITTI's, whose focal length is 5.8 times shorter. With
# factors of 2.7 and 12, the angle on Udacity's drive had an RMSE of 0.0408 and 0.0396 rad.
NO_SCALE = math.log(5.8)
# Correlation time in seconds of the scale's error.
SCALE_S = 20.0
# Time in seconds over which the share of frames with a road is averaged.
SHARE_S = 20.0
# Standard deviation of the logarithm of a length by depth, beside the scale, before the drive has
# shown its own: 0.038 to 0.051 on KITTI drives 0005, 0039 and 0042.
DEPTH_SPREAD = 0.04
# Correlation time in seconds of this error: 0.7 to 1.5 on the three drives.
DEPTH_S = 1.0
# Time in seconds over which lengths by depth are compared with those by ratios.
LAG_S = 1.0
# Time in seconds of the drive that weighs as much as DEPTH_SPREAD.
KNOWN_S = 5.0
# Relative standard deviation of the scale of a drive's speeds, if the camera's height over the road
# is known: the root mean square of the logarithms of 1.069, 1.031, 1.119 and 1.054, the mean ratios
# of measured to recorded speeds of four drives on which odometry was not tuned. On the eight drives
# on which it was, the root mean square is 0.039. docs/measure.md has all twelve.
KNOWN_HEIGHT_SIGMA = 0.07
# Relative standard deviation of this scale if the camera's height is unknown.
UNKNOWN_HEIGHT_SIGMA = 0.2
# Least speed in m/s whose logarithm is taken.
LEAST_MPS = 0.3
# Relative standard deviation of a measured speed, apart from the errors that last.
LEAST_NOISE = 0.01
# Least trust with which a ratio is used. Trust is the square of the share of recent frames with a
# road.
LEAST_TRUST = 0.25

# Largest distance of a ratio from the lengths by depth, in standard deviations of both, with which
# it is used. On 76 drives of the sample, the largest of 2,875 is 2.8; on the seven drives of KITTI
# in docs/measure.md that were tuned on, the largest of 2,394 is 2.4.
GATE = 4.0

# Entries of the filter's state: the logarithm of the speed over TYPICAL_MPS, that one step before,
# the scale's error in standard deviations, and the error of depth that lasts for DEPTH_S.
_SPEED = 0
_BEFORE = 1
_SCALE = 2
_DEPTH = 3
# A ratio is the difference of the first two.
_BY_RATIO = np.array([1.0, -1.0, 0.0, 0.0])


class Speeds(NamedTuple):
    """Measured speeds of M steps, in ascending order."""

    time_s: np.ndarray  # [M]
    speed_mps: np.ndarray  # [M], forward positive
    road: np.ndarray  # bool [M]: a road was found, which gives depth its scale
    # Speeds [M] relative to that of the step before, by triangulation; 0 if unknown.
    ratio: np.ndarray
    ratio_sigma: np.ndarray  # standard deviations [M] of their logarithms


class Estimate(NamedTuple):
    """Estimated speeds of M steps."""

    speed_mps: np.ndarray  # [M], forward positive
    sigma: np.ndarray  # relative standard deviations [M]


class _Filtered(NamedTuple):
    """A step of the filter: its state and covariance, as predicted and as corrected."""

    transition: np.ndarray  # [4,4] from the step before
    predicted: np.ndarray  # [4]
    predicted_covariance: np.ndarray  # [4,4]
    state: np.ndarray  # [4]
    covariance: np.ndarray  # [4,4]


def filter_speeds(speeds: Speeds) -> Estimate:
    """Return the speeds by this and earlier steps only."""
    steps = _run_filter(speeds)
    states = [step.state for step in steps]
    return _read_states(speeds, states, [step.covariance for step in steps])


def smooth_speeds(speeds: Speeds) -> Estimate:
    """Return the speeds by all steps, later ones included (Rauch, Tung and Striebel)."""
    steps = _run_filter(speeds)
    states = [step.state for step in steps]
    covariances = [step.covariance for step in steps]
    for row in range(len(steps) - 2, -1, -1):
        step = steps[row]
        after = steps[row + 1]
        # The gain is covariance transitionᵀ predicted_covariance⁻¹.
        gain = np.linalg.solve(after.predicted_covariance, after.transition @ step.covariance).T
        states[row] = step.state + gain @ (states[row + 1] - after.predicted)
        change = covariances[row + 1] - after.predicted_covariance
        covariances[row] = step.covariance + gain @ change @ gain.T
    return _read_states(speeds, states, covariances)


def _run_filter(speeds: Speeds) -> list[_Filtered]:
    """Return the steps of the filter.

    The logarithm of a measured speed is that of the true one, plus sigma times a scale error of
    variance 1, plus an error of depth. All three are Ornstein-Uhlenbeck processes: the speed with
    mean TYPICAL_MPS, SPREAD and SPREAD_S, the scale error with SCALE_S, the error of depth with
    DEPTH_S. Where a road gives the scale, sigma is small. Without a road, the speed stays near a
    typical one: a depth network has no scale for a lens that differs much from its training lens.
    """
    steps: list[_Filtered] = []
    road_share = 0.0
    depth_spread = _DepthSpread()
    state = np.zeros(4)
    covariance = np.diag([SPREAD, SPREAD, 1.0, DEPTH_SPREAD]) ** 2

    for row, step_s in enumerate(np.diff(speeds.time_s, prepend=speeds.time_s[:1])):
        # The more of the recent frames show a road, the better are scale and ratios: without one,
        # points are far away, and their small parallaxes err alike.
        update = max(1 - math.exp(-step_s / SHARE_S), 1 / (row + 1))
        road_share += update * (float(speeds.road[row]) - road_share)
        trust = road_share**2

        # Predict: all components return to their means.
        keep = np.exp(-step_s / np.array([SPREAD_S, SCALE_S, DEPTH_S]))
        transition = np.zeros((4, 4))
        transition[[_SPEED, _SCALE, _DEPTH], [_SPEED, _SCALE, _DEPTH]] = keep
        transition[_BEFORE, _SPEED] = 1.0
        spread = np.array([SPREAD, 1.0, depth_spread.sigma * trust])
        added = np.zeros(4)
        added[[_SPEED, _SCALE, _DEPTH]] = (1 - keep**2) * spread**2
        predicted = transition @ state
        predicted_covariance = transition @ covariance @ transition.T + np.diag(added)
        state = predicted
        covariance = predicted_covariance

        # Correct by the length.
        measured = math.log(max(abs(speeds.speed_mps[row]), LEAST_MPS) / TYPICAL_MPS)
        scale_sigma = NO_SCALE * (ROAD_SCALE / NO_SCALE) ** trust
        by_depth = np.array([1.0, 0.0, scale_sigma, 1.0])
        state, covariance = _correct_state(state, covariance, by_depth, measured, LEAST_NOISE)

        # Correct by the ratio to the step before, unless the lengths contradict it.
        log_ratio = None
        sigma = float(speeds.ratio_sigma[row])
        if row and speeds.ratio[row] > 0 and trust > LEAST_TRUST:
            sigma /= trust
            log_ratio = math.log(speeds.ratio[row])
            # The error of depth lasts, but may also change at once by its spread.
            both_sigma = math.hypot(sigma, depth_spread.sigma)
            if _is_outlier(state, covariance, _BY_RATIO, log_ratio, both_sigma):
                log_ratio = None
            else:
                state, covariance = _correct_state(state, covariance, _BY_RATIO, log_ratio, sigma)
        depth_spread.add_step(float(speeds.time_s[row]), measured, log_ratio, sigma)
        steps.append(_Filtered(transition, predicted, predicted_covariance, state, covariance))
    return steps


def _correct_state(
    state: np.ndarray, covariance: np.ndarray, observation: np.ndarray, value: float, sigma: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return state and covariance after a measured value, `observation` times the state."""
    variance = observation @ covariance @ observation + sigma**2
    gain = covariance @ observation / variance
    corrected = state + gain * (value - observation @ state)
    return corrected, covariance - np.outer(gain, observation @ covariance)


def _is_outlier(
    state: np.ndarray, covariance: np.ndarray, observation: np.ndarray, value: float, sigma: float
) -> bool:
    """Return whether a measured value is farther from the state than GATE standard deviations."""
    variance = observation @ covariance @ observation + sigma**2
    return abs(value - observation @ state) > GATE * math.sqrt(variance)


class _DepthSpread:
    """Learns the spread of lengths by depth from their changes beside those by ratios."""

    def __init__(self) -> None:
        self._squares = DEPTH_SPREAD**2 * KNOWN_S
        self._time_s = KNOWN_S
        # Steps of an unbroken stretch of ratios: the time, the logarithm of the length by depth
        # less that by ratios, and the variance of the latter.
        self._offsets: list[tuple[float, float, float]] = []
        self._by_ratios = 0.0
        self._variance = 0.0

    @property
    def sigma(self) -> float:
        """The standard deviation of the logarithm of a length by depth, beside the scale."""
        return math.sqrt(max(self._squares / self._time_s, LEAST_NOISE**2))

    def add_step(
        self, time_s: float, measured: float, log_ratio: float | None, sigma: float
    ) -> None:
        """Add a step: the logarithm of its speed, and that of its ratio to the step before."""
        if log_ratio is None:
            self._offsets = []
        else:
            self._by_ratios += log_ratio
            self._variance += sigma**2
        offset = measured - self._by_ratios
        self._offsets.append((time_s, offset, self._variance))

        while len(self._offsets) > 1 and self._offsets[1][0] <= time_s - LAG_S:
            self._offsets.pop(0)
        first_s, first_offset, first_variance = self._offsets[0]
        if time_s - first_s >= LAG_S:
            # Two independent errors differ by twice the variance, errors LAG_S apart by less.
            by_depth = (offset - first_offset) ** 2 - (self._variance - first_variance)
            step_s = time_s - self._offsets[-2][0]
            self._squares += by_depth / (2 * (1 - math.exp(-LAG_S / DEPTH_S))) * step_s
            self._time_s += step_s


def _read_states(
    speeds: Speeds, states: list[np.ndarray], covariances: list[np.ndarray]
) -> Estimate:
    """Return the speeds by the states of the filter, with the signs of the measured ones."""
    if not states:
        return Estimate(np.zeros(0), np.zeros(0))
    magnitude_mps = np.maximum(np.abs(speeds.speed_mps), LEAST_MPS)
    estimated_mps = TYPICAL_MPS * np.exp(np.array(states)[:, _SPEED])
    variance = np.array(covariances)[:, _SPEED, _SPEED]
    return Estimate(speeds.speed_mps * estimated_mps / magnitude_mps, np.sqrt(variance))
