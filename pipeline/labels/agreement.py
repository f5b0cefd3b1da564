"""Measure how the values of a log follow those that are measured in images: correlation, lag, gain
and offset.

What can be judged depends on the noise of the measured values. A frame turns if its measured yaw
rate is beyond TURNS_SIGMAS standard deviations, so half a minute of a motorway can tell as much as
a few corners of a city.
"""

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from pipeline.labels.label import Labels
from pipeline.motion.rates import YAW_NOISE_RADPS

# A measured yaw rate beyond this many standard deviations is a turn, not noise.
TURNS_SIGMAS = 3.0

# Lags that are tried first. A steering wheel may lead the yaw rate by 0.2 s.
NEAR_S = np.array(sorted(np.arange(-40, 41) / 20, key=abs))
# Lags of a log with another clock, for instance GPS time, which is 18 s ahead of UTC.
FAR_S = np.array(sorted(np.arange(-300, 301) / 10, key=abs))
# Frames that have both values at a far lag: fewer show a single bend, which any other bend
# resembles.
FAR_FRAMES = 60
# Largest gain, or its inverse, of a log that follows at a far lag.
FAR_GAIN = 3.0
# Distance of lags that are alternatives, and not neighbours of the same maximum.
APART_S = 2.0

# Least correlation of a log that follows, without noise: eight healthy logs have 0.978 and more.
FOLLOWS = 0.95
# Share of the measured variance that noise may leave unexplained, in variances of the noise.
UNEXPLAINED = 1.5**2
# Least correlation, after the allowance for noise, that tells a log from another one.
TELLING = 0.8
# Ratio of standard deviation and root mean square below which values are steady: no correlation is
# defined.
STEADY = 0.2

# A log is stuck if it stays equal while the measured values, without a tenth of them on each side,
# vary by more than these standard deviations, plus a share of the recorded value. Rendered bends
# reach 3.4 of them for 3 s.
STUCK_SIGMAS = 5.0
STUCK_SHARE = 0.1
# Turning frames during which a log of zeros is stuck.
ZERO_FRAMES = 20
# Largest recorded value where the measured one is 0: in sigmas of the measurement, plus a share of
# its root mean square. Healthy logs have up to 1.2 sigmas.
OFFSET_SIGMAS = 2.0
OFFSET_SHARE = 0.025
# A bend that never straightens tells its offset by the gain alone: share of its least measured
# value.
OFFSET_GAP = 0.1
# Frames that an offset needs: a single short bend, which is measured at changing depths, has an
# apparent one.
OFFSET_FRAMES = 60
# Least speed in m/s that has a sign: at standstill, recorded speeds reach -0.15.
MOVES_MPS = 0.5
# Turning frames that a third of the frames needs to tell its own lag, and its least correlation
# there.
THIRD_FRAMES = 40
THIRD_FOLLOWS = 0.9


class Noise(NamedTuple):
    """Standard deviations of measured rates [F], NaN where they are not measured."""

    yaw_rate_radps: np.ndarray
    speed: np.ndarray  # relative

    def at(self, rows: np.ndarray) -> "Noise":
        """Return the standard deviations of some `rows`."""
        return Noise(self.yaw_rate_radps[rows], self.speed[rows])


class Pair(NamedTuple):
    """Recorded and measured labels of the frames [F] of a drive; measured rates are means that look
    ahead.
    """

    time_s: np.ndarray
    recorded: Labels
    measured: Labels
    # None: estimated from the scatter of the yaw rates; the speed is exact
    noise: Noise | None = None


class Moments(NamedTuple):
    """Statistics of measured values m and recorded values r, in the frames that have both."""

    correlation: float  # 0 if m or r is steady
    mean_m: float
    mean_r: float
    std_m: float
    std_r: float
    rms_m: float
    rms_r: float

    @property
    def gain(self) -> float:
        """Return recorded / measured values, by their variations or, where these are steady, by
        their magnitudes.
        """
        if self.correlation:
            return self.std_r / self.std_m
        return max(self.rms_r, 1e-6) / max(self.rms_m, 1e-6)

    def follows(self, noise: float) -> bool:
        """Return whether r follows m as closely as the `noise` of m allows, with either sign."""
        return self.correlation**2 >= max(self.needed(noise), TELLING**2)

    def needed(self, noise: float) -> float:
        """Return the least square of the correlation that a log needs to follow m."""
        return FOLLOWS**2 - UNEXPLAINED * noise**2 / max(self.std_m**2, 1e-12)


class Fit(NamedTuple):
    """How recorded values follow measured ones, at the lag with the largest magnitude of their
    correlation.
    """

    frames: int  # with both values
    turning: int  # of these
    correlation: float  # without a lag
    lag_s: float  # of the log, positive if it is late
    best: float  # correlation at this lag; 0 on a steady curve, or if the log is constant
    # by how much the lag raises the magnitude of the correlation beyond what noise can
    lag_gain: float
    judged: bool  # the measured values vary so much that a log of another road would differ
    follows: bool  # as closely as noise allows, with either sign
    one_sided: bool  # all recorded values have the same sign, or are 0
    # if one-sided, largest correlation of the log with the magnitudes of the measured values
    magnitude: float
    other_side: int  # if one-sided, number of frames that turn to the other side
    gain: float  # recorded / measured
    offset: float  # recorded value where the measured one is 0
    off_centre: bool  # the offset is larger than noise and the offsets of healthy logs explain
    cosine: float  # of both values in turning frames, without a lag
    thirds_s: tuple[float, ...]  # lag of each third that follows
    stuck_s: float  # longest time for which the log stays equal while the measured values vary
    far_s: float | None  # lag at which the log of another clock would follow


class Speed(NamedTuple):
    """How recorded speeds follow measured ones."""

    frames: int  # with both
    gain: float  # recorded / measured root mean square
    ahead: int  # frames that go ahead by the log and are measured backwards
    back: int  # frames that go backwards by the log and are measured ahead


class Agreement(NamedTuple):
    """How a log agrees with measured motion; None where the log or the measurement has no value."""

    turning: int = 0  # frames that turn, with a recorded value
    angle: Fit | None = None
    yaw_rate: Fit | None = None
    speed: Speed | None = None
    speed_sigma: float = 0.0  # median relative standard deviation of the measured speed

    def content(self) -> dict[str, Any]:
        """Return the values for a JSON file."""
        fits = {
            name: value._asdict()
            for name, value in self._asdict().items()
            if isinstance(value, Fit | Speed)
        }
        return {"turning": self.turning, "speed_sigma": self.speed_sigma, **fits}


def compare(pairs: Sequence[Pair]) -> Agreement:
    """Return how the recorded values of drives follow the measured ones."""
    pairs = [pair for pair in pairs if len(pair.time_s)]
    if not pairs:
        return Agreement()
    angle = _fit(pairs, "steering_rad")
    yaw_rate = _fit(pairs, "yaw_rate_radps")
    turning = max((fit.turning for fit in (angle, yaw_rate) if fit), default=0)
    sigmas = np.concatenate([pair.noise.speed for pair in pairs if pair.noise] or [np.zeros(1)])
    sigmas = sigmas[np.isfinite(sigmas)]
    speed_sigma = float(np.median(sigmas)) if len(sigmas) else 0.0
    return Agreement(turning, angle, yaw_rate, _speed(pairs), speed_sigma)


def backwards(recorded: Labels, measured: Labels) -> np.ndarray:
    """Return the frames that are measured backwards while the log goes ahead, bool [F]; slow frames
    do not count.
    """
    return _moves(recorded) & _moves(measured) & (measured.speed_mps < 0) & (recorded.speed_mps > 0)


def _moves(labels: Labels) -> np.ndarray:
    return labels.valid & (np.abs(labels.speed_mps) >= MOVES_MPS)  # false for NaN


def _speed(pairs: Sequence[Pair]) -> Speed | None:
    recorded = np.concatenate(
        [np.where(_moves(pair.recorded), pair.recorded.speed_mps, np.nan) for pair in pairs]
    )
    measured = np.concatenate(
        [np.where(_moves(pair.measured), pair.measured.speed_mps, np.nan) for pair in pairs]
    )
    both = np.isfinite(recorded) & np.isfinite(measured)
    if not both.any():
        return None
    # above 0, as both move
    gain = np.sqrt(np.mean(recorded[both] ** 2) / np.mean(measured[both] ** 2))
    ahead = np.sum((recorded > 0) & (measured < 0))
    back = np.sum((recorded < 0) & (measured > 0))
    return Speed(int(both.sum()), float(gain), int(ahead), int(back))


def _fit(pairs: Sequence[Pair], name: str) -> Fit | None:
    """Return how recorded values of the field `name` follow measured ones; None without a frame
    that has both.
    """
    m = np.concatenate([_valid(pair.measured, name) for pair in pairs])
    r = _at_lag(pairs, name, 0.0)
    used = np.isfinite(m) & np.isfinite(r)
    if not used.any():
        return None

    # The lag at which the log follows best, and by how much better than without one.
    shifted = [_at_lag(pairs, name, lag_s) for lag_s in NEAR_S]
    near = [_moments(m, values, least=used.sum() / 2) for values in shifted]
    correlations = np.array([moments.correlation for moments in near])
    best = int(np.argmax(np.abs(correlations)))
    at_best = near[best]
    noise = _noise(pairs, name)
    slack = noise**2 / max(at_best.std_m**2, 1e-12)
    lag_gain = abs(at_best.correlation) - abs(near[0].correlation) - slack

    # Direction and side of the turns, which a steady bend shows, too.
    turning = used & np.concatenate([_turns(pair) for pair in pairs])
    length = math.sqrt((m[turning] ** 2).sum() * (r[turning] ** 2).sum())
    cosine = (m[turning] * r[turning]).sum() / length if length else 0.0

    one_sided = bool((r[used] >= 0).all() or (r[used] <= 0).all())
    other_side = 0
    magnitude = 0.0
    if one_sided:
        other_side = int((turning & (m * np.sign(r[used].sum()) < 0)).sum())
        magnitude = max(
            _moments(np.abs(m), values, least=used.sum() / 2).correlation for values in shifted
        )

    # The recorded value straight ahead, which is known if the car comes near to it.
    straightest = float(np.percentile(np.abs(m[used]), 5))
    largest_offset = OFFSET_SIGMAS * noise + OFFSET_SHARE * at_best.rms_m + OFFSET_GAP * straightest
    follows = at_best.follows(noise)
    gain = at_best.gain
    offset = (
        at_best.mean_r - math.copysign(gain, at_best.correlation) * at_best.mean_m
        if follows
        else 0.0
    )
    return Fit(
        frames=int(used.sum()),
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
        off_centre=bool(used.sum() >= OFFSET_FRAMES and abs(offset) > largest_offset),
        cosine=float(cosine),
        thirds_s=_lags_of_thirds(m, shifted, turning),
        stuck_s=max(_stuck_s(pair, name) for pair in pairs),
        far_s=None if follows and at_best.correlation > 0 else _far_lag(pairs, name, m, noise),
    )


def _valid(labels: Labels, name: str) -> np.ndarray:
    return np.where(labels.valid, getattr(labels, name), np.nan)


def _at_lag(pairs: Sequence[Pair], name: str, lag_s: float) -> np.ndarray:
    """Return the recorded values that are `lag_s` late, at the frames of all pairs [N]; NaN where
    there are none.
    """
    parts = []
    for pair in pairs:
        values = _valid(pair.recorded, name)
        parts.append(np.interp(pair.time_s + lag_s, pair.time_s, values, np.nan, np.nan))
    return np.concatenate(parts)


def _yaw_sigma(pair: Pair) -> np.ndarray:
    """Return the standard deviations of the measured yaw rates [F] in rad/s.

    Unknown ones follow from the scatter of successive rates: of independent noise, the median
    magnitude of the differences is 0.954 standard deviations.
    """
    if pair.noise:
        return np.nan_to_num(pair.noise.yaw_rate_radps, nan=YAW_NOISE_RADPS)
    yaw_radps = pair.measured.yaw_rate_radps[pair.measured.valid]
    scatter_radps = (
        float(np.median(np.abs(np.diff(yaw_radps)))) / 0.954 if len(yaw_radps) > 1 else 0.0
    )
    return np.full(len(pair.time_s), max(YAW_NOISE_RADPS, scatter_radps))


def _turns(pair: Pair) -> np.ndarray:
    """Return which frames turn, bool [F]."""
    # false for NaN
    return np.abs(_valid(pair.measured, "yaw_rate_radps")) > TURNS_SIGMAS * _yaw_sigma(pair)


def _sigma(pair: Pair, name: str) -> np.ndarray:
    """Return the standard deviations of the measured values [F]; for an angle, those of the yaw
    rate times L / v.
    """
    sigma = _yaw_sigma(pair)
    if name == "steering_rad":
        with np.errstate(divide="ignore", invalid="ignore"):
            sigma = sigma * np.abs(pair.measured.steering_rad / pair.measured.yaw_rate_radps)
    return np.nan_to_num(sigma, nan=0.0, posinf=0.0)


def _noise(pairs: Sequence[Pair], name: str) -> float:
    """Return the root mean square of the standard deviations of the measured values; 0 without
    any.
    """
    sigma = np.concatenate([_sigma(pair, name)[pair.measured.valid] for pair in pairs])
    return float(np.sqrt(np.mean(sigma**2))) if len(sigma) else 0.0


def _moments(m: np.ndarray, r: np.ndarray, least: float) -> Moments:
    """Return the statistics of values [N], NaN where unknown; without correlation below the `least`
    number.
    """
    used = np.isfinite(m) & np.isfinite(r)
    if not used.any():
        return Moments(*[0.0] * len(Moments._fields))
    m = m[used]
    r = r[used]
    rms_m = math.sqrt(np.mean(m**2))
    rms_r = math.sqrt(np.mean(r**2))
    std_m = float(m.std())
    std_r = float(r.std())
    correlation = 0.0
    if std_m > STEADY * rms_m and std_r > STEADY * rms_r and len(m) > least:
        correlation = float(np.mean((m - m.mean()) * (r - r.mean()))) / (std_m * std_r)
    return Moments(correlation, float(m.mean()), float(r.mean()), std_m, std_r, rms_m, rms_r)


def _lags_of_thirds(
    m: np.ndarray, shifted: Sequence[np.ndarray], turning: np.ndarray
) -> tuple[float, ...]:
    """Return the lag of each third of the frames that follows; `shifted`: recorded values [N] at
    each of NEAR_S.
    """
    lags_s = list[float]()
    for rows in np.array_split(np.arange(len(m)), 3):
        least = np.isfinite(m[rows] + shifted[0][rows]).sum() / 2
        correlations = [_moments(m[rows], values[rows], least).correlation for values in shifted]
        if turning[rows].sum() >= THIRD_FRAMES and max(correlations) > THIRD_FOLLOWS:
            lags_s.append(float(NEAR_S[np.argmax(correlations)]))
    return tuple(lags_s)


def _stuck_s(pair: Pair, name: str) -> float:
    """Return the longest time for which the log stays equal while the measured values vary, or is 0
    in turns.
    """
    values = _valid(pair.recorded, name)  # a frame without a value has 0 in the file
    measured = _valid(pair.measured, name)
    sigma = _sigma(pair, name)
    turning = _turns(pair)
    longest_s = 0.0
    edges = [0, *(np.flatnonzero(np.diff(values) != 0) + 1), len(values)]  # NaN differs from NaN
    for first, last in pairwise(edges):
        rows = np.arange(first, last)[pair.measured.valid[first:last]]
        if not len(rows):
            continue
        low, high = np.percentile(measured[rows], [10, 90])
        varies = high - low > STUCK_SIGMAS * np.median(sigma[rows]) + STUCK_SHARE * abs(
            values[first]
        )
        is_zero_in_turns = values[first] == 0 and turning[rows].sum() >= ZERO_FRAMES
        if varies or is_zero_in_turns:
            longest_s = max(longest_s, float(np.ptp(pair.time_s[rows])))
    return longest_s


def _far_lag(pairs: Sequence[Pair], name: str, m: np.ndarray, noise: float) -> float | None:
    """Return the lag of FAR_S at which the log follows, with a plausible gain; None if there is
    none.

    The other lags have to explain it much worse, since a bend resembles other bends.
    """
    at_lag = [_moments(m, _at_lag(pairs, name, lag_s), least=FAR_FRAMES) for lag_s in FAR_S]
    correlations = np.array([moments.correlation for moments in at_lag])
    best = int(np.argmax(correlations))
    moments = at_lag[best]
    if not (moments.correlation > 0 and moments.follows(noise)):
        return None
    rival = np.abs(correlations[np.abs(FAR_S - FAR_S[best]) > APART_S]).max()
    distinct = 1 - moments.correlation**2 < (1 - rival**2) / 2
    alike = abs(math.log(moments.gain)) < math.log(FAR_GAIN)
    return float(FAR_S[best]) if distinct and alike else None
