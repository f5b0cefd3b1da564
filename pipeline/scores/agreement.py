"""State how recorded values follow the values that are measured in images: a line per quantity.

The numbers are facts, of which docs/measure.md has a table that says how to read them. No cause is
named. A line begins with DOUBT if the numbers are not those of a healthy log.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from pipeline.base.summary import DOUBT
from pipeline.labels.label import REVERSING_MPS

# Least measured yaw rate of a turning frame, in standard deviations of this yaw rate.
TURNS_SIGMAS = 3.0
# Lags in seconds that are tried, the smallest first. GPS time is 18 s ahead of UTC.
LAGS_S = np.array(sorted(np.arange(-400, 401) / 20, key=abs))
# Least number of frames that have both values at a lag. In fewer, any bend resembles another one.
LAG_FRAMES = 60
# Least correlation at which a log is of this drive, so that its gain, lag and offset count. Healthy
# pieces of 15 to 60 s with TURNING_FRAMES have 0.998 and more on KITTI's drive 0005 and odometry
# 09, by which it was chosen. They have 0.915 and more on drives 0039 and 0095, odometry 03 and
# Udacity's HMB_4, whose lens covers 17 degrees.
FOLLOWS = 0.8
# Number of turning frames from which a log has to follow.
TURNING_FRAMES = 100
# Least correlation of a log, even if fewer frames turn.
RESEMBLES = 0.5
# Number of turning frames from which a log has to have this correlation.
FEW_TURNING_FRAMES = 40
# Largest gain of a healthy log. Its inverse is the smallest one. A simulator's steering from -1 to
# 1, read as an angle in rad, has 1.72.
GAIN = 1.4
# Least lag in seconds of a doubtful log. A steering wheel leads the yaw rate by up to 0.3 s.
LATE_S = 0.35
# Largest offset of a healthy log, relative to the root mean square of the measured values.
OFFSET = 0.5
# Largest ratio of recorded to measured speed of a healthy log. Its inverse is the smallest one.
SPEED_RATIO = 1.4
# Largest share of the moving frames in which the sign of a healthy speed differs from the measured
# one.
CONTRADICTED = 0.02


class Pair(NamedTuple):
    """Yaw rates or angles of a drive's frames [F], recorded and measured; NaN where unknown."""

    time_s: np.ndarray
    recorded: np.ndarray
    measured: np.ndarray
    turns: np.ndarray  # bool, whether the car turns by the measured yaw rate

    def constant_s(self) -> float:
        """Return for how many seconds the recorded value is constant at most while the car turns.

        In a stretch of equal values, only steps between two turning frames count.
        """
        step_s = np.diff(self.time_s)
        turns = self.turns[1:] & self.turns[:-1]
        stretches = _constant_stretches(self.recorded)
        seconds = [step_s[rows[:-1]][turns[rows[:-1]]].sum() for rows in stretches]
        return float(max(seconds, default=0.0))


class SpeedPair(NamedTuple):
    """Speeds in m/s of a drive's frames [F], recorded and measured; NaN where unknown."""

    time_s: np.ndarray
    recorded: np.ndarray
    measured: np.ndarray
    sigma: np.ndarray  # standard deviation of the measured speed

    def constant_s(self) -> float:
        """Return for how many seconds the recorded value is constant at most while speed changes.

        The speed changes in a stretch of equal values if the measured one changes by more than the
        median of its standard deviation there.
        """
        seconds = [0.0]
        for rows in _constant_stretches(self.recorded):
            rows = rows[np.isfinite(self.measured[rows])]
            if len(rows) > 1 and np.ptp(self.measured[rows]) > np.median(self.sigma[rows]):
                seconds.append(float(self.time_s[rows[-1]] - self.time_s[rows[0]]))
        return max(seconds)


class Follow(NamedTuple):
    """How recorded values follow measured ones, at the lag with the strongest correlation."""

    frames: int  # number of frames with both values
    turning: int  # number of these frames that turn
    correlation: float  # 0 if one of both is constant
    lag_s: float  # positive if the log is late
    gain: float  # ratio of recorded to measured standard deviation
    offset: float  # recorded value at a measured value of 0
    measured_rms: float  # root mean square of the measured values
    constant_s: float  # longest time for which a recorded value is constant while the car turns


class Speed(NamedTuple):
    """How recorded speeds follow measured ones, in frames that move by the measured one."""

    frames: int
    ratio: float  # ratio of the median magnitudes, recorded to measured
    contradicted_frames: int  # number of frames in which the signs differ
    constant_s: float  # longest time for which a recorded value is constant while speed changes


class _Line(NamedTuple):
    """The line recorded = offset + slope · measured, at some lag."""

    correlation: float = 0.0
    gain: float = 0.0
    offset: float = 0.0


def is_turning(yaw_rate_radps: np.ndarray, sigma_radps: np.ndarray) -> np.ndarray:
    """Return which frames turn, bool [F], by measured yaw rates and their standard deviations."""
    return np.abs(yaw_rate_radps) > TURNS_SIGMAS * sigma_radps  # false for NaN


def fit_log(drives: Sequence[Pair]) -> Follow | None:
    """Return how the recorded values of drives follow the measured ones.

    All drives have the same lag. It is the smallest of those with the strongest correlation. A lag
    other than 0 counts if LAG_FRAMES, and half of all compared frames, have both values at it. The
    result is None if no frame has both values.
    """
    recorded = _shift_logs(drives, 0.0)
    measured = np.concatenate([pair.measured for pair in drives])
    turns = np.concatenate([pair.turns for pair in drives])
    compared = np.isfinite(recorded) & np.isfinite(measured)
    frames = int(compared.sum())
    if not frames:
        return None

    best_s = 0.0
    best = _fit_line(recorded, measured)
    # Not more frames have both values at a lag than are measured.
    lags_s = LAGS_S[1:].tolist() if np.isfinite(measured).sum() >= LAG_FRAMES else []
    for lag_s in lags_s:
        shifted = _shift_logs(drives, lag_s)
        common = np.sum(np.isfinite(shifted) & np.isfinite(measured))
        if common >= max(LAG_FRAMES, frames / 2):
            line = _fit_line(shifted, measured)
            if abs(line.correlation) > abs(best.correlation):
                best_s = lag_s
                best = line

    return Follow(
        frames=frames,
        turning=int(turns[compared].sum()),
        correlation=best.correlation,
        lag_s=best_s,
        gain=best.gain,
        offset=best.offset,
        measured_rms=math.sqrt(np.mean(measured[compared] ** 2)),
        constant_s=max(pair.constant_s() for pair in drives),
    )


def _shift_logs(drives: Sequence[Pair], lag_s: float) -> np.ndarray:
    """Return the recorded values [N] of all drives, for logs that are `lag_s` late.

    They are NaN beyond the ends of a log.
    """
    values = []
    for pair in drives:
        late_s = pair.time_s + lag_s
        values.append(np.interp(late_s, pair.time_s, pair.recorded, np.nan, np.nan))
    return np.concatenate(values)


def _fit_line(recorded: np.ndarray, measured: np.ndarray) -> _Line:
    """Return the line through values [N], NaN where unknown. At least one frame has both."""
    compared = np.isfinite(recorded) & np.isfinite(measured)
    recorded = recorded[compared]
    measured = measured[compared]
    if not (np.ptp(recorded) > 0 and np.ptp(measured) > 0):
        return _Line(offset=float(recorded.mean()))
    mean_r = float(recorded.mean())
    mean_m = float(measured.mean())
    std_r = float(recorded.std())
    std_m = float(measured.std())
    correlation = float(np.mean((recorded - mean_r) * (measured - mean_m))) / (std_r * std_m)
    gain = std_r / std_m
    return _Line(correlation, gain, offset=mean_r - math.copysign(gain, correlation) * mean_m)


def _constant_stretches(recorded: np.ndarray) -> list[np.ndarray]:
    """Return the rows of each stretch of equal values [F]. NaN equals nothing."""
    changes = np.flatnonzero(recorded[1:] != recorded[:-1]) + 1
    return np.split(np.arange(len(recorded)), changes)


def compare_speeds(drives: Sequence[SpeedPair]) -> Speed | None:
    """Return how recorded speeds follow measured ones.

    The result is None if no frame with a recorded speed moves by the measured one.
    """
    recorded = np.concatenate([pair.recorded for pair in drives])
    measured = np.concatenate([pair.measured for pair in drives])
    # The comparison is false for NaN.
    moves = np.isfinite(recorded) & (np.abs(measured) >= -REVERSING_MPS)
    if not moves.any():
        return None
    recorded = recorded[moves]
    measured = measured[moves]
    return Speed(
        frames=len(recorded),
        ratio=float(np.median(np.abs(recorded)) / np.median(np.abs(measured))),
        contradicted_frames=int(np.sum(recorded * measured < 0)),
        constant_s=max(pair.constant_s() for pair in drives),
    )


def turns_line(name: str, unit: str, facts: Follow, *, advise: bool) -> str:
    """Return the line about yaw rates or angles. `name` is the quantity and its log.

    With `advise`, it has the offset that takes the lag away.
    """
    lag = f"{facts.lag_s:+.2f} s"
    if facts.lag_s:
        late = "late" if facts.lag_s > 0 else "early"
        option = f": --offset {-facts.lag_s:+.2f}" if advise else ""
        lag += f" (the log is {late}{option})"
    text = (
        f"{name}: correlation {facts.correlation:.2f} with the measured one at a lag of {lag}; "
        f"gain {facts.gain:.2f}, offset {facts.offset:z.3f} {unit}; {facts.frames:,} frames, "
        f"{facts.turning:,} of them turn; constant for at most {facts.constant_s:.1f} s while the "
        "car turns"
    )
    follows = abs(facts.correlation) >= FOLLOWS
    is_unlike = (
        facts.correlation < 0
        or not 1 / GAIN <= facts.gain <= GAIN
        or abs(facts.lag_s) >= LATE_S
        or abs(facts.offset) > OFFSET * facts.measured_rms
    )
    is_another = (facts.correlation < FOLLOWS and facts.turning >= TURNING_FRAMES) or (
        facts.correlation < RESEMBLES and facts.turning >= FEW_TURNING_FRAMES
    )
    if (follows and is_unlike) or is_another:
        return DOUBT + text
    return text


def speed_line(name: str, facts: Speed, *, height_known: bool) -> str:
    """Return the line about speeds. `height_known` tells whether the scale is known."""
    share = facts.contradicted_frames / facts.frames
    text = (
        f"{name}: {facts.ratio:.2f} times the measured one; the sign differs in "
        f"{facts.contradicted_frames:,} of {facts.frames:,} moving frames; constant for at most "
        f"{facts.constant_s:.1f} s while the measured one changes"
    )
    if not height_known:
        text += "; the scale is not known"
    is_unlike = height_known and not 1 / SPEED_RATIO <= facts.ratio <= SPEED_RATIO
    if is_unlike or share > CONTRADICTED:
        return DOUBT + text
    return text
