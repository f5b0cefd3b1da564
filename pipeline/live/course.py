"""The course of a car from the measured motion of frames: smoothed rates, steering angle, track, and uncertainties."""

import math
from collections import deque
from collections.abc import Generator, Iterable, Sequence
from contextlib import closing

import numpy as np

from pipeline.labels.label import Car
from pipeline.live.chain import Course, FrameState
from pipeline.motion.step import STANDSTILL

# Standard deviations of Gaussian means. A driver turns the wheel in a second, and a car changes its speed more slowly;
# a speed from one pair of images has much more noise than a yaw rate.
YAW_SIGMA_S, SPEED_SIGMA_S = 0.2, 0.5
REACH = 2.0  # sigmas on both sides
BRIDGED_S = 1.0  # longest gap over which the track continues with the last motion
# Speeds of KITTI's 55 drives, above 1.5 m/s: geometric mean of the drives' medians; standard deviation and correlation
# time of the logarithm in a drive.
TYPICAL_MPS, SPREAD, SPREAD_S = 8.4, 0.4, 20.0
# Standard deviations of the logarithm of depth's scale where all, and where no recent frame shows a road; correlation
# times of the scale's error and of the share of frames with a road. NO_SCALE: a depth network sees a lens of 17 degrees
# as if it was KITTI's, whose focal length is 5.8 times shorter.
ROAD_SCALE, NO_SCALE, SCALE_S, SHARE_S = 0.03, math.log(5.8), 20.0, 20.0
HEIGHT_SCALE = 0.2  # of a camera of unknown height over the road
LEAST_MPS = 0.3  # in logarithms
YAW_NOISE_RADPS, SPEED_NOISE = 0.003, 0.01  # least errors of means: KITTI odometry 03 has 0.2 deg/s


def add_courses(frames: Generator[FrameState], car: Car, *, smooth: bool, height_known: bool) -> Generator[FrameState]:
    """Add the course to each frame whose motion is measured; closes `frames`.

    Args:
        frames: in order.
        car: for the steering angle.
        smooth: take means over neighbouring frames, later ones included, so frames come a second late.
        height_known: of the camera over the road.
    """
    track = _Track(car, 0.0 if height_known else HEIGHT_SCALE)
    recent: deque[FrameState] = deque()
    waiting = 0  # index in `recent` of the first frame without a course
    reach_s = REACH * max(YAW_SIGMA_S, SPEED_SIGMA_S) if smooth else 0.0
    with closing(frames):
        for frame in frames:
            frame.image = frame.depth_m = frame.cls = frame.scan = None  # not needed any more
            recent.append(frame)
            while waiting < len(recent) and recent[waiting].time_s <= frame.time_s - reach_s:
                yield track.add(recent[waiting], recent)
                waiting += 1
            while recent[0].time_s < recent[min(waiting, len(recent) - 1)].time_s - reach_s:
                recent.popleft()
                waiting -= 1
    for late in list(recent)[waiting:]:
        yield track.add(late, recent)


class SpeedFilter:
    """A Kalman filter that separates changes of speed from errors of depth's scale.

    The logarithm of a measured speed is that of the true one, plus sigma times a scale error of variance 1. Both are
    Ornstein-Uhlenbeck processes, the speed with mean TYPICAL_MPS, SPREAD and SPREAD_S, the error with SCALE_S. Where a
    road gives the scale, sigma is small, and the filter follows the measurement. Without a road it stays near a typical
    speed: a depth network has no scale for a lens that differs much from that of its training.
    """

    def __init__(self) -> None:
        self._state, self._covariance = np.zeros(2), np.diag([SPREAD**2, 1.0])
        self._last_s, self._count, self._road = math.nan, 0, 0.0  # share of recent frames with a road

    def add(self, time_s: float, speed_mps: float, road: bool, noise: float) -> tuple[float, float]:
        """Return the filtered speed and its relative standard deviation.

        Args:
            time_s: of the measurement; times ascend.
            speed_mps: measured.
            road: whether a road was found.
            noise: relative standard deviation of the measurement, apart from the scale.
        """
        step_s = time_s - self._last_s if self._count else 0.0
        self._last_s, self._count = time_s, self._count + 1
        self._road += max(1 - math.exp(-step_s / SHARE_S), 1 / self._count) * (road - self._road)
        sigma = NO_SCALE * (ROAD_SCALE / NO_SCALE) ** self._road**2
        keep = np.exp([-step_s / SPREAD_S, -step_s / SCALE_S])
        state, covariance = keep * self._state, np.outer(keep, keep) * self._covariance
        covariance += np.diag((1 - keep**2) * [SPREAD**2, 1.0])
        observation, measured = np.array([1.0, sigma]), math.log(max(abs(speed_mps), LEAST_MPS) / TYPICAL_MPS)
        gain = covariance @ observation / (observation @ covariance @ observation + noise**2)
        self._state = state + gain * (measured - observation @ state)
        self._covariance = covariance - np.outer(gain, observation @ covariance)
        return speed_mps * math.exp(self._state[0] - measured), math.sqrt(self._covariance[0, 0])


class _Track:
    """Integrates the motion of frames in order."""

    def __init__(self, car: Car, height_sigma: float) -> None:
        self._car, self._height_sigma, self._filter = car, height_sigma, SpeedFilter()
        self._x_m = self._y_m = self._heading_rad = 0.0
        self._yaw_rate_radps = self._speed_mps = self._yaw_sigma_radps = self._speed_sigma = 0.0
        self._measured_s, self._last_s = -math.inf, math.nan

    def add(self, frame: FrameState, neighbours: Iterable[FrameState]) -> FrameState:
        """Add the course to the next frame, with means over its `neighbours`, itself included."""
        if frame.estimate:
            self._smooth(frame, [other for other in neighbours if other.estimate])
            self._measured_s = frame.time_s
        elif frame.problem in STANDSTILL or frame.time_s - self._measured_s > BRIDGED_S:
            self._yaw_rate_radps = self._speed_mps = 0.0
        step_s = 0.0 if math.isnan(self._last_s) else frame.time_s - self._last_s
        self._last_s = frame.time_s
        turned_rad = self._yaw_rate_radps * step_s
        self._x_m += self._speed_mps * step_s * math.cos(self._heading_rad + turned_rad / 2)
        self._y_m += self._speed_mps * step_s * math.sin(self._heading_rad + turned_rad / 2)
        self._heading_rad += turned_rad
        if frame.estimate:
            curvature_1pm = steering_rad = sigma_rad = None
            if abs(self._speed_mps) >= self._car.min_speed_mps:
                curvature_1pm, wheelbase_m = self._yaw_rate_radps / self._speed_mps, self._car.wheelbase_m
                steering_rad = math.atan(wheelbase_m * curvature_1pm)
                sigma_1pm = math.hypot(self._yaw_sigma_radps / self._speed_mps, curvature_1pm * self._speed_sigma)
                sigma_rad = wheelbase_m * math.cos(steering_rad) ** 2 * sigma_1pm
            rates, pose = (self._speed_mps, self._yaw_rate_radps), (self._x_m, self._y_m, self._heading_rad)
            frame.course = Course(*rates, curvature_1pm, steering_rad, *pose, self._speed_sigma, sigma_rad)
        return frame

    def _smooth(self, frame: FrameState, measured: Sequence[FrameState]) -> None:
        """Update rates and their standard deviations by the `measured` neighbours of a frame."""
        seconds = np.array([other.time_s - frame.time_s for other in measured])
        estimates = [other.estimate for other in measured if other.estimate]
        yaw_rates, speeds = (
            np.array([getattr(estimate, name) for estimate in estimates]) for name in ("yaw_rate_radps", "speed_mps")
        )
        self._yaw_rate_radps, yaw_noise_radps = _mean(seconds, yaw_rates, YAW_SIGMA_S)
        speed_mps, noise_mps = _mean(seconds, speeds, SPEED_SIGMA_S)
        noise = max(SPEED_NOISE, noise_mps / max(abs(speed_mps), LEAST_MPS))
        road = "visual" not in frame.estimates or math.isfinite(frame.road_height_m)  # scans need none
        self._speed_mps, sigma = self._filter.add(frame.time_s, speed_mps, road, noise)
        self._yaw_sigma_radps = max(YAW_NOISE_RADPS, yaw_noise_radps)
        self._speed_sigma = math.hypot(sigma, self._height_sigma)


def _mean(seconds: np.ndarray, values: np.ndarray, sigma_s: float) -> tuple[float, float]:
    """Return the Gaussian mean of values [N] at `seconds` [N] from the centre, and its error.

    The error is that of independent noise, whose consecutive differences have a median of 0.954 standard deviations.
    """
    weights = np.exp(-((seconds / sigma_s) ** 2) / 2) * (np.abs(seconds) <= REACH * sigma_s)
    weights /= weights.sum()
    error = float(np.median(np.abs(np.diff(values)))) / 0.954 if len(values) > 1 else 0.0
    return float(weights @ values), error * math.sqrt(float(weights @ weights))
