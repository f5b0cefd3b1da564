"""Fit the ratio between a steering wheel and the front wheels to the measured motion.

The model is wheel(t + delay) = ratio · angle(t) + zero, where angle is that of the front wheels.
Measured angles are regressed on the wheel's, which are almost exact. The other way round, the noise
of the measured angles would make the ratio too small.

The model has no understeer: the faster a car is, the more its wheels turn for the same curvature.
So the ratio is that at the speeds of the drive, and larger than the mechanical one.
"""

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from scipy import stats

from pipeline.evaluate.statistics import interval_text, parts, sums_by_part
from pipeline.ingest.log import Log

# Delays of the wheel's log in seconds that are tried.
DELAYS_S = np.arange(-40, 41) / 20
# Length in seconds of a stretch of the drive. Errors of the speed last for seconds, so that shorter
# stretches are not independent of each other.
STRETCH_S = 10.0
# Half of a 95 % interval in standard deviations of a normal distribution.
NORMAL_95 = 1.96


class WheelFit(NamedTuple):
    """The fitted numbers, with 95 % intervals."""

    ratio: float  # negative if the log has the other sign
    ratio_ci95: tuple[float, float]
    zero_rad: float  # angle of the steering wheel when the car drives straight ahead
    zero_rad_ci95: tuple[float, float]
    delay_s: float  # positive if the log is later than the measured motion
    delay_s_ci95: tuple[float, float]
    speed_mps: float  # median measured speed of the frames

    def angle_rad(self, log: Log, time_s: np.ndarray) -> np.ndarray:
        """Return the angle of the front wheels [F] by the log, for frames at `time_s` [F]."""
        wheel_rad = _wheel_rad(log, _halfway(time_s) + self.delay_s)
        return (wheel_rad - self.zero_rad) / self.ratio

    def line(self) -> str:
        """Return the numbers as a line for the user."""
        ratio = f"steering ratio {self.ratio:#.3g} ({interval_text(self.ratio_ci95, '#.3g')})"
        zero = f"zero {self.zero_rad:z.3f} rad ({interval_text(self.zero_rad_ci95, 'z.3f')})"
        delay = f"delay {self.delay_s:z.2f} s ({interval_text(self.delay_s_ci95, 'z.2f')})"
        return (
            f"wheel fitted to the measured motion, 95 % intervals: {ratio}, {zero}, {delay}; "
            "a wrong lens, camera height or wheelbase scales the ratio"
        )


class _Lines(NamedTuple):
    """Lines that are fitted to M selections of stretches, measured = slope · (wheel - zero)."""

    slope: np.ndarray  # [M]
    zero_rad: np.ndarray  # [M]
    delay_s: np.ndarray  # [M]


def fit_wheel(log: Log, table: Mapping[str, np.ndarray]) -> WheelFit | None:
    """Return the ratio, zero and delay of a steering wheel's log.

    The result is None if the interval of the ratio has no end, since the car turns too little or in
    a single stretch of the drive.

    The intervals are by the jackknife: the fit is repeated without each stretch of STRETCH_S. They
    cover errors that differ between stretches. That of the ratio also covers an error of the speed
    that is the same in all frames, of the size of ``speed_sigma``. They do not cover a wrong lens,
    a wrong wheelbase, or understeer.

    Args:
        log: the wheel's log. Its `ratio` is a guess, on which only the weights of frames depend.
        table: columns [F] of :func:`steer.outcome.read_course`, and ``time_s``.
    """
    sums = _sum_terms(log, table)
    if sums.shape[1] < 2:
        return None

    # Fit all stretches, and all but one.
    total = sums.sum(axis=1, keepdims=True)
    fitted = _fit_lines(total)
    without = _fit_lines(total - sums)
    slope = float(fitted.slope[0])
    zero_rad = float(fitted.zero_rad[0])
    delay_s = float(fitted.delay_s[0])

    # An error of the speed that is the same in all frames multiplies the ratio.
    measured = np.isfinite(table["measured_rad"])
    common = NORMAL_95 * float(np.median(table["speed_sigma"][measured]))
    error = _reach(without.slope) / abs(slope)  # relative
    if not error < 1:  # true for NaN
        return None
    nearer = math.exp(-math.hypot(math.log1p(error), common)) / slope
    farther = math.exp(math.hypot(math.log1p(-error), common)) / slope

    zero_reach_rad = _reach(without.zero_rad)
    delay_reach_s = _reach(without.delay_s)
    return WheelFit(
        ratio=1 / slope,
        ratio_ci95=(min(nearer, farther), max(nearer, farther)),
        zero_rad=zero_rad,
        zero_rad_ci95=(zero_rad - zero_reach_rad, zero_rad + zero_reach_rad),
        delay_s=delay_s,
        delay_s_ci95=(delay_s - delay_reach_s, delay_s + delay_reach_s),
        speed_mps=float(np.median(np.abs(table["speed_mps"][measured]))),
    )


def _halfway(time_s: np.ndarray) -> np.ndarray:
    """Return the middles [F] of the steps that end at `time_s` [F].

    The measured rates of a frame are means over such a step.
    """
    return time_s - np.median(np.diff(time_s)) / 2


def _wheel_rad(log: Log, time_s: np.ndarray) -> np.ndarray:
    """Return the angle of the steering wheel [F] in the file of a log."""
    return log.ratio * log.at(time_s)[0]


def _sum_terms(log: Log, table: Mapping[str, np.ndarray]) -> np.ndarray:
    """Return the sums [L,D,6] of the terms of a regression, for L delays, over D stretches.

    The terms are 1, w, w², m, wm and m², times the weight of the frame, for the wheel's angle w and
    the measured angle m.
    """
    time_s = _halfway(table["time_s"])
    wheel_rad = np.stack([_wheel_rad(log, time_s + delay_s) for delay_s in DELAYS_S])  # [L,F]
    measured_rad = np.broadcast_to(table["measured_rad"], wheel_rad.shape)
    terms = [
        np.ones_like(wheel_rad),
        wheel_rad,
        wheel_rad**2,
        measured_rad,
        wheel_rad * measured_rad,
        measured_rad**2,
    ]
    weight = 1 / _sigma_rad(log, table) ** 2
    weighted = weight[:, None] * np.stack(terms, axis=-1)

    # At all delays, the same frames count.
    counted = np.isfinite(measured_rad[0]) & np.isfinite(wheel_rad).all(axis=0)
    step_s = np.median(np.diff(time_s))
    stretch = parts(np.zeros(len(time_s), int), round(STRETCH_S / step_s))
    return sums_by_part(weighted, counted[:, None], stretch)


def _sigma_rad(log: Log, table: Mapping[str, np.ndarray]) -> np.ndarray:
    """Return the standard deviations of the measured angles [F].

    The part of them that is an error of the speed is proportional to the angle. It is computed from
    the log: by measured angles, those that are too small would have larger weights.
    """
    by_speed_rad = np.sin(2 * table["measured_rad"]) / 2 * table["speed_sigma"]
    by_yaw_rate_rad = np.sqrt(table["measured_sigma_rad"] ** 2 - by_speed_rad**2)
    return np.hypot(by_yaw_rate_rad, log.at(table["time_s"])[0] * table["speed_sigma"])


def _fit_lines(sums: np.ndarray) -> _Lines:
    """Return the lines with the least squared error at the best of L delays.

    `sums` [L,M,6] are those of :func:`_sum_terms` over M selections of stretches.
    """
    means = sums[..., 1:] / sums[..., :1]
    wheel, wheel_wheel, measured, wheel_measured, measured_measured = np.moveaxis(means, -1, 0)
    covariance = wheel_measured - wheel * measured
    # The wheel may stand still in all stretches but one.
    with np.errstate(divide="ignore", invalid="ignore"):
        slope = covariance / (wheel_wheel - wheel**2)
        zero_rad = wheel - measured / slope
    error = measured_measured - measured**2 - slope * covariance  # [L,M]

    # The best delay is the lowest point of the parabola through three errors.
    column = np.arange(error.shape[1])
    best = np.clip(error.argmin(axis=0), 1, len(error) - 2)
    before = error[best - 1, column]
    least = error[best, column]
    after = error[best + 1, column]
    with np.errstate(divide="ignore", invalid="ignore"):
        shift = np.clip((before - after) / (before - 2 * least + after) / 2, -0.5, 0.5)
    delay_s = DELAYS_S[best] + shift * (DELAYS_S[1] - DELAYS_S[0])
    return _Lines(slope[best, column], zero_rad[best, column], delay_s)


def _reach(without: np.ndarray) -> float:
    """Return half of the 95 % interval of a number, from its values without each of D stretches."""
    others = len(without) - 1
    return float(stats.t.ppf(0.975, others) * math.sqrt(others * np.var(without)))
