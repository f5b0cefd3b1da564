"""Measure how well the values of a log follow the values that are measured in images.

The measures are correlation, lag, gain and offset. How much they tell depends on the noise of the
measured values. A frame turns if its measured yaw rate exceeds TURNS_SIGMAS standard deviations of
the noise. So half a minute of a motorway can tell as much as a few corners in a city.
"""

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from pipeline.labels.label import Labels
from pipeline.motion.rates import YAW_NOISE_RADPS

# Least measured yaw rate of a turn, in standard deviations of its noise.
TURNS_SIGMAS = 3.0

# Lags in seconds that are tried first. A steering wheel may lead the yaw rate by 0.2 s. They are
# sorted by magnitude, so the first one is 0.
NEAR_S = np.array(sorted(np.arange(-40, 41) / 20, key=abs))
# Lags in seconds that are tried for a log that may have another clock, for instance GPS time, which
# is 18 s ahead of UTC.
FAR_S = np.array(sorted(np.arange(-300, 301) / 10, key=abs))
# Least number of frames that have a recorded and a measured value at a far lag. Fewer frames show a
# single bend, which any other bend resembles.
FAR_FRAMES = 60
# Largest plausible gain at a far lag. The inverse is the smallest plausible gain.
FAR_GAIN = 3.0
# Least distance in seconds between far lags that are alternatives. Closer lags belong to the same
# maximum of the correlation.
APART_S = 2.0

# Least correlation at which a log follows measured values that have no noise. Eight healthy logs
# have 0.978 and more.
FOLLOWS = 0.95
# Variance of the measured values that noise may leave unexplained, in variances of the noise.
UNEXPLAINED = 1.5**2
# Least correlation at which a log follows, however strong the noise is. A weaker correlation would
# not tell the log from another one.
TELLING = 0.8
# Ratio of standard deviation to root mean square up to which values are steady. Steady values have
# no defined correlation.
STEADY = 0.2

# Least variation of the measured values, in their standard deviations, during which a constant log
# is stuck. The lowest and the highest tenth of the values do not count. In 3 s, the variation
# reaches 3.4 in rendered bends.
STUCK_SIGMAS = 5.0
# Share of the constant recorded value that is added to this least variation.
STUCK_SHARE = 0.1
# Least number of turning frames during which a log of zeros is stuck.
ZERO_FRAMES = 20
# Largest offset of a healthy log, in standard deviations of the measured values. The offset is the
# recorded value at a measured value of 0. Healthy logs have offsets of up to 1.2.
OFFSET_SIGMAS = 2.0
# Share of the measured root mean square that is added to the largest offset.
OFFSET_SHARE = 0.025
# Share of the least measured magnitude that is added to the largest offset, too. In a bend that
# never straightens, the offset depends on the gain alone.
OFFSET_GAP = 0.1
# Least number of frames that tell an offset. A single short bend, which is measured at changing
# depths, seems to have an offset.
OFFSET_FRAMES = 60
# Least magnitude in m/s of a speed whose sign counts. At standstill, recorded speeds reach -0.15.
MOVES_MPS = 0.5
# Least number of turning frames in a third of all frames that gives the third a lag.
THIRD_FRAMES = 40
# Correlation at its best lag that such a third has to exceed.
THIRD_FOLLOWS = 0.9


class Noise(NamedTuple):
    """Standard deviations of measured rates [F], NaN where they are not measured."""

    yaw_rate_radps: np.ndarray
    speed: np.ndarray  # relative

    def at(self, rows: np.ndarray) -> "Noise":
        """Return the standard deviations in some `rows`."""
        return Noise(self.yaw_rate_radps[rows], self.speed[rows])


class Pair(NamedTuple):
    """Recorded and measured labels of a drive's frames [F].

    Measured rates are means over neighbouring frames, later ones included.
    """

    time_s: np.ndarray
    recorded: Labels
    measured: Labels
    noise: Noise


class Moments(NamedTuple):
    """Statistics of measured values m and recorded values r, in the frames that have both."""

    correlation: float = 0.0  # 0 if m or r is steady
    mean_m: float = 0.0
    mean_r: float = 0.0
    std_m: float = 0.0
    std_r: float = 0.0
    rms_m: float = 0.0
    rms_r: float = 0.0

    @property
    def gain(self) -> float:
        """Return the ratio of recorded to measured standard deviation.

        If values are steady, it is the ratio of their root mean squares.
        """
        if self.correlation:
            return self.std_r / self.std_m
        return max(self.rms_r, 1e-6) / max(self.rms_m, 1e-6)

    def follows(self, noise: float) -> bool:
        """Return whether r follows m as closely as the `noise` of m allows, with either sign.

        `noise` is a standard deviation.
        """
        return self.correlation**2 >= max(self.needed(noise), TELLING**2)

    def needed(self, noise: float) -> float:
        """Return the least square of the correlation that a log needs to follow m."""
        return FOLLOWS**2 - UNEXPLAINED * noise**2 / max(self.std_m**2, 1e-12)


class Fit(NamedTuple):
    """How recorded values follow measured ones, at the lag with the strongest correlation."""

    frames: int  # number of frames with both values
    turning: int  # number of these frames that turn
    correlation: float  # correlation without a lag
    lag_s: float  # lag of the log with the strongest correlation, positive if the log is late
    best: float  # correlation at this lag; 0 if the values are steady
    lag_gain: float  # increase of |correlation| by the lag, beyond what noise can cause
    judged: bool  # whether the measured values vary enough to expose a log of another road
    follows: bool  # whether the log follows as closely as noise allows, with either sign
    one_sided: bool  # whether all recorded values have the same sign, or are 0
    magnitude: float  # if one-sided, best correlation with the magnitudes of the measured values
    other_side: int  # if one-sided, number of frames whose measured turn is to the other side
    gain: float  # ratio of recorded to measured values
    offset: float  # recorded value at a measured value of 0; 0 if the log does not follow
    off_centre: bool  # whether the offset is larger than noise and healthy logs explain
    cosine: float  # cosine similarity of both values in turning frames, without a lag
    thirds_s: tuple[float, ...]  # lags of those thirds of the frames that follow
    stuck_s: float  # longest time for which the log stays equal while the measured values vary
    far_s: float | None  # lag at which the log would follow if it had another clock


class Speed(NamedTuple):
    """How recorded speeds follow measured ones."""

    frames: int  # number of moving frames with both speeds
    gain: float  # ratio of recorded to measured root mean square
    ahead: int  # number of frames that go ahead by the log and are measured backwards
    back: int  # number of frames that go backwards by the log and are measured ahead


class Agreement(NamedTuple):
    """How a log agrees with measured motion.

    A field is None if no frame has both a recorded and a measured value of the quantity.
    """

    turning: int = 0  # number of turning frames with a recorded value
    angle: Fit | None = None
    yaw_rate: Fit | None = None
    speed: Speed | None = None
    speed_sigma: float = 0.0  # median relative standard deviation of the measured speed

    def content(self) -> dict[str, Any]:
        """Return the values for a JSON file."""
        content: dict[str, Any] = {"turning": self.turning, "speed_sigma": self.speed_sigma}
        for name in ("angle", "yaw_rate", "speed"):
            fit = getattr(self, name)
            if fit:
                content[name] = fit._asdict()
        return content


def compare(pairs: Sequence[Pair]) -> Agreement:
    """Return how the recorded values of drives follow the measured ones."""
    pairs = [pair for pair in pairs if len(pair.time_s)]
    if not pairs:
        return Agreement()
    angle = _fit(pairs, "steering_rad")
    yaw_rate = _fit(pairs, "yaw_rate_radps")
    turning = max((fit.turning for fit in (angle, yaw_rate) if fit), default=0)
    return Agreement(turning, angle, yaw_rate, _compare_speed(pairs), _speed_sigma(pairs))


def backwards(recorded: Labels, measured: Labels) -> np.ndarray:
    """Return whether a frame is measured backwards while the log goes ahead, bool [F].

    Frames that are slower than MOVES_MPS do not count.
    """
    return _moves(recorded) & _moves(measured) & (measured.speed_mps < 0) & (recorded.speed_mps > 0)


def _moves(labels: Labels) -> np.ndarray:
    return labels.valid & (np.abs(labels.speed_mps) >= MOVES_MPS)  # false for NaN


def _moving_speed(labels: Labels) -> np.ndarray:
    return np.where(_moves(labels), labels.speed_mps, np.nan)


def _compare_speed(pairs: Sequence[Pair]) -> Speed | None:
    recorded = np.concatenate([_moving_speed(pair.recorded) for pair in pairs])
    measured = np.concatenate([_moving_speed(pair.measured) for pair in pairs])
    compared = np.isfinite(recorded) & np.isfinite(measured)
    if not compared.any():
        return None
    # The divisor is not 0, since all compared speeds are of moving frames.
    gain = np.sqrt(np.mean(recorded[compared] ** 2) / np.mean(measured[compared] ** 2))
    ahead = np.sum((recorded > 0) & (measured < 0))
    back = np.sum((recorded < 0) & (measured > 0))
    return Speed(int(compared.sum()), float(gain), int(ahead), int(back))


def _speed_sigma(pairs: Sequence[Pair]) -> float:
    sigmas = np.concatenate([pair.noise.speed for pair in pairs])
    sigmas = sigmas[np.isfinite(sigmas)]
    if not len(sigmas):
        return 0.0
    return float(np.median(sigmas))


def _fit(pairs: Sequence[Pair], name: str) -> Fit | None:
    """Return how recorded values of the field `name` follow measured ones.

    It is None if no frame has both values.
    """
    measured = np.concatenate([_valid(pair.measured, name) for pair in pairs])
    recorded = _at_lag(pairs, name, 0.0)
    compared = np.isfinite(measured) & np.isfinite(recorded)
    if not compared.any():
        return None
    # At a lag, more than half of these frames must still have both values.
    least = compared.sum() / 2

    # Find the lag at which the log follows best, and the correlation that it gains by this lag. An
    # increase up to `slack` may be noise.
    shifted = [_at_lag(pairs, name, lag_s) for lag_s in NEAR_S]
    near = [_moments(measured, values, least) for values in shifted]
    correlations = np.array([moments.correlation for moments in near])
    best = int(np.argmax(np.abs(correlations)))
    at_best = near[best]
    noise = _noise(pairs, name)
    slack = noise**2 / max(at_best.std_m**2, 1e-12)
    lag_gain = abs(at_best.correlation) - abs(near[0].correlation) - slack
    follows = at_best.follows(noise)

    # Compare the directions of turns, which are defined in a steady bend, too.
    turning = compared & np.concatenate([_turns(pair) for pair in pairs])
    cosine = _cosine(measured[turning], recorded[turning])
    one_sided = bool((recorded[compared] >= 0).all() or (recorded[compared] <= 0).all())
    other_side = 0
    magnitude = 0.0
    if one_sided:
        side = np.sign(recorded[compared].sum())
        other_side = int((turning & (measured * side < 0)).sum())
        unsigned = [_moments(np.abs(measured), values, least) for values in shifted]
        magnitude = max(moments.correlation for moments in unsigned)

    # Compute the recorded value straight ahead. The limit grows if the car never drives straight.
    straightest = float(np.percentile(np.abs(measured[compared]), 5))
    largest_offset = OFFSET_SIGMAS * noise + OFFSET_SHARE * at_best.rms_m + OFFSET_GAP * straightest
    gain = at_best.gain
    offset = 0.0
    if follows:
        offset = at_best.mean_r - math.copysign(gain, at_best.correlation) * at_best.mean_m

    # A log that does not follow may have another clock.
    far_s = None
    if not (follows and at_best.correlation > 0):
        far_s = _far_lag(pairs, name, measured, noise)

    return Fit(
        frames=int(compared.sum()),
        turning=int(turning.sum()),
        correlation=near[0].correlation,
        lag_s=float(NEAR_S[best]),
        best=at_best.correlation,
        lag_gain=lag_gain,
        judged=at_best.needed(noise) >= TELLING**2,
        follows=follows,
        one_sided=one_sided,
        magnitude=magnitude,
        other_side=other_side,
        gain=gain,
        offset=offset,
        off_centre=bool(compared.sum() >= OFFSET_FRAMES and abs(offset) > largest_offset),
        cosine=cosine,
        thirds_s=_lags_of_thirds(measured, shifted, turning),
        stuck_s=max(_stuck_s(pair, name) for pair in pairs),
        far_s=far_s,
    )


def _valid(labels: Labels, name: str) -> np.ndarray:
    return np.where(labels.valid, getattr(labels, name), np.nan)


def _at_lag(pairs: Sequence[Pair], name: str, lag_s: float) -> np.ndarray:
    """Return the recorded values [N] at the frames of all pairs, for a log that is `lag_s` late.

    They are NaN beyond the ends of the log.
    """
    late = []
    for pair in pairs:
        values = _valid(pair.recorded, name)
        late.append(np.interp(pair.time_s + lag_s, pair.time_s, values, np.nan, np.nan))
    return np.concatenate(late)


def _cosine(a: np.ndarray, b: np.ndarray) -> float:
    length = math.sqrt((a**2).sum() * (b**2).sum())
    if not length:
        return 0.0
    return float((a * b).sum() / length)


def _yaw_sigma(pair: Pair) -> np.ndarray:
    """Return the standard deviations of the measured yaw rates [F] in rad/s."""
    return np.nan_to_num(pair.noise.yaw_rate_radps, nan=YAW_NOISE_RADPS)


def _turns(pair: Pair) -> np.ndarray:
    """Return which frames turn, bool [F]."""
    yaw_radps = _valid(pair.measured, "yaw_rate_radps")
    return np.abs(yaw_radps) > TURNS_SIGMAS * _yaw_sigma(pair)  # false for NaN


def _sigma(pair: Pair, name: str) -> np.ndarray:
    """Return the standard deviations of the measured values [F]."""
    sigma = _yaw_sigma(pair)
    if name == "steering_rad":
        # The angle is the yaw rate times L / v, and so is its standard deviation.
        with np.errstate(divide="ignore", invalid="ignore"):
            sigma = sigma * np.abs(pair.measured.steering_rad / pair.measured.yaw_rate_radps)
    return np.nan_to_num(sigma, nan=0.0, posinf=0.0)


def _noise(pairs: Sequence[Pair], name: str) -> float:
    """Return the root mean square of the standard deviations of all measured values.

    It is 0 if nothing is measured.
    """
    sigma = np.concatenate([_sigma(pair, name)[pair.measured.valid] for pair in pairs])
    if not len(sigma):
        return 0.0
    return float(np.sqrt(np.mean(sigma**2)))


def _moments(m: np.ndarray, r: np.ndarray, least: float) -> Moments:
    """Return the statistics of measured values `m` and recorded values `r` [N], NaN where unknown.

    The correlation is 0 unless more than `least` frames have both values.
    """
    compared = np.isfinite(m) & np.isfinite(r)
    if not compared.any():
        return Moments()
    m = m[compared]
    r = r[compared]
    rms_m = math.sqrt(np.mean(m**2))
    rms_r = math.sqrt(np.mean(r**2))
    std_m = float(m.std())
    std_r = float(r.std())
    correlation = 0.0
    if std_m > STEADY * rms_m and std_r > STEADY * rms_r and len(m) > least:
        correlation = float(np.mean((m - m.mean()) * (r - r.mean()))) / (std_m * std_r)
    return Moments(correlation, float(m.mean()), float(r.mean()), std_m, std_r, rms_m, rms_r)


def _lags_of_thirds(
    measured: np.ndarray, shifted: Sequence[np.ndarray], turning: np.ndarray
) -> tuple[float, ...]:
    """Return the lags of those thirds of the frames that follow.

    `shifted` holds the recorded values [N] for each lag of NEAR_S.
    """
    lags_s = list[float]()
    for rows in np.array_split(np.arange(len(measured)), 3):
        # The sum is NaN in a frame that lacks one of both values.
        least = np.isfinite(measured[rows] + shifted[0][rows]).sum() / 2
        moments = [_moments(measured[rows], values[rows], least) for values in shifted]
        correlations = [at_lag.correlation for at_lag in moments]
        if turning[rows].sum() >= THIRD_FRAMES and max(correlations) > THIRD_FOLLOWS:
            lags_s.append(float(NEAR_S[np.argmax(correlations)]))
    return tuple(lags_s)


def _stuck_s(pair: Pair, name: str) -> float:
    """Return the longest time for which the log stays equal while the measured values vary.

    A log of zeros is stuck while the car turns.
    """
    recorded = _valid(pair.recorded, name)  # NaN in a frame without a value, which has 0 in a file
    measured = _valid(pair.measured, name)
    sigma = _sigma(pair, name)
    turning = _turns(pair)
    longest_s = 0.0
    changes = np.flatnonzero(np.diff(recorded) != 0) + 1  # NaN differs from NaN
    for first, end in pairwise([0, *changes, len(recorded)]):
        rows = np.arange(first, end)[pair.measured.valid[first:end]]
        if not len(rows):
            continue
        value = recorded[first]
        low, high = np.percentile(measured[rows], [10, 90])
        varies = high - low > STUCK_SIGMAS * np.median(sigma[rows]) + STUCK_SHARE * abs(value)
        is_zero_in_turns = value == 0 and turning[rows].sum() >= ZERO_FRAMES
        if varies or is_zero_in_turns:
            longest_s = max(longest_s, float(np.ptp(pair.time_s[rows])))
    return longest_s


def _far_lag(pairs: Sequence[Pair], name: str, measured: np.ndarray, noise: float) -> float | None:
    """Return the lag of FAR_S at which the log follows, or None if it follows at none of them.

    The gain has to be plausible. The other lags have to explain the log much worse, since a bend
    resembles other bends: they have to leave more than twice as much variance unexplained.
    """
    at_lag = [_moments(measured, _at_lag(pairs, name, lag_s), least=FAR_FRAMES) for lag_s in FAR_S]
    correlations = np.array([moments.correlation for moments in at_lag])
    best = int(np.argmax(correlations))
    moments = at_lag[best]
    if not (moments.correlation > 0 and moments.follows(noise)):
        return None
    rival = np.abs(correlations[np.abs(FAR_S - FAR_S[best]) > APART_S]).max()
    distinct = 1 - moments.correlation**2 < (1 - rival**2) / 2
    plausible = abs(math.log(moments.gain)) < math.log(FAR_GAIN)
    if not (distinct and plausible):
        return None
    return float(FAR_S[best])
