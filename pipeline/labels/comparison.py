"""Compare labels from two sources: errors of measured motion, and faults of what was recorded."""

import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from pipeline.base.errors import InputError
from pipeline.base.store import DriveReader
from pipeline.labels import source as sources
from pipeline.labels.label import TURNING_RAD, Car, Labels, held
from pipeline.metrics import nmse

LAGS_S = np.array(sorted(np.arange(-40, 41) / 20, key=abs))  # [L]
STEADY = 0.2  # standard deviation / root mean square: below, no correlation is defined
SHOWN, SIGNED, JUDGED = 20, 40, 100  # turning frames that a comparison, an inverted sign and other errors need
# The cosine of recorded and measured values, of turning frames, is 0.97 to 1 in all parts of eight healthy logs that
# have SIGNED turning frames; where the sign is inverted, it is the opposite.
OPPOSITE = -0.93
CLEAR, FOLLOWS = 0.9, 0.95  # least correlations: of few frames; of many: eight healthy logs have 0.978 and more
# KITTI's and rendered drives agree to 0.05 s with a correlation of 0.997, of which a lag of 0.25 s costs 0.02. A
# steering wheel may lead the yaw rate by 0.2 s. Lags of the thirds of a healthy log differ by up to 0.1 s.
LATE_S, LATE_COST, DRIFT_S = 0.2, 0.01, 0.3
MAGNITUDE = 0.1  # by how much magnitudes correlate better than values with a sign
STUCK_S, STUCK_RAD = 2.0, 4 * TURNING_RAD  # a recorded angle stays equal for longer, while the measured one varies
OFF_CENTRE = 0.2  # of the root mean square of measured values, when these are 0: healthy logs have up to 0.06
DEGREES, SIMILAR = math.degrees(1), 0.1  # 57.3 within a factor of 1.5: healthy gains are 0.7 to 1.2
# Logarithms of gains. Karlsruhe's cameras measure 1.2 times the speed, a camera 1.2 m above the road 1.38 times. The
# yaw rate depends on no scale, but on the focal length: in 243 rendered drives its gain is 0.93 to 1.07.
UNLIKE, UNLIKE_SPEED, UNLIKE_YAW = math.log(1.3), math.log(1.4), math.log(1.15)
MOST = 2  # doubts shown about one recording


class Pair(NamedTuple):
    """Recorded and measured labels of the frames [F] of a drive; measured rates are means that look ahead."""

    time_s: np.ndarray
    recorded: Labels
    measured: Labels


def errors(measured: Labels, true: Labels) -> np.ndarray:
    """Return errors of the labels from one source against those of another, for the same frames, for :func:`score`.

    [5,F]: measured, 0 or 1; then, NaN where not compared, the error of the yaw rate in rad/s, measured / true speed,
    the error of the angle in rad, and the true angle. An angle that is not measured repeats the last one.
    """
    both, held_rad = measured.valid & true.valid, held(measured.steering_rad, measured.valid, initial=np.nan)
    yaw_radps = np.where(both, measured.yaw_rate_radps - true.yaw_rate_radps, np.nan)
    ratio = np.divide(measured.speed_mps, true.speed_mps, out=np.full(len(both), np.nan), where=both)
    true_rad = np.where(true.valid & np.isfinite(held_rad), true.steering_rad, np.nan)
    return np.stack([measured.valid, yaw_radps, ratio, held_rad - true_rad, true_rad])


def score(drives: Sequence[np.ndarray]) -> dict[str, Any] | None:
    """Return the scores over all frames of `drives`, each of :func:`errors`; None without frames. Undefined: None.

    ``valid``: share of valid labels; ``judged``: frames in nmse; ``speed_ratio``: median of measured / true speed;
    ``nmse``: of the last measured steering angle.
    """
    measured, *compared = np.concatenate([np.zeros((5, 0)), *drives], axis=1)
    if not len(measured):
        return None
    yaw_radps, ratio, error_rad, true_rad = (values[np.isfinite(values)] for values in compared)
    yaw_degps = np.degrees(yaw_radps)
    return {
        "drives": sum(drive.size > 0 for drive in drives),
        "frames": len(measured),
        "valid": float(measured.mean()),
        "judged": len(true_rad),
        "yaw_rmse_degps": float(np.sqrt((yaw_degps**2).mean())) if len(yaw_degps) else None,
        "yaw_median_degps": float(np.median(np.abs(yaw_degps))) if len(yaw_degps) else None,
        "speed_ratio": float(np.median(ratio)) if len(ratio) else None,
        "nmse": nmse.score(true_rad, true_rad + error_rad),
    }


def read(source: str, drives: Sequence[str], ingest: Path, motion: Path, car: Car) -> dict[str, Pair]:
    """Return drive → labels, without drives that lack the recorded `source` or measured motion.

    `ingest`, `motion`: the folders of these stages.
    """
    result = {}
    for drive in drives:
        path = motion / f"{drive}.h5"
        with DriveReader(ingest / f"{drive}.h5", stage="ingest") as raw:
            recorded = sources.recorded(raw, car).get(source)
            if recorded and path.is_file():
                result[drive] = Pair(raw.time_s, recorded, sources.read("visual", raw, path, car))
    return result


def compare(pairs: Sequence[Pair]) -> dict[str, Any]:
    """Return how recorded values follow measured ones.

    ``turning``: frames that turn by the measured angle. ``angle``, ``yaw_rate`` and ``speed``, where recorded: see
    :func:`_fit`, and ``stuck_s``, the longest time for which the recording stays equal while the measured angle varies.
    """
    result, turns = dict[str, Any](turning=0), np.zeros(0, bool)
    for key, name in (("angle", "steering_rad"), ("yaw_rate", "yaw_rate_radps"), ("speed", "speed_mps")):
        lagged = [_lagged(pair, name) for pair in pairs if len(pair.time_s)]
        if not lagged:
            continue
        m, r = (np.concatenate(values, axis=-1) for values in zip(*lagged, strict=True))  # [N], [L,N]
        if key == "angle":
            turns = np.abs(m) > TURNING_RAD  # false for NaN
            result["turning"] = int((turns & np.isfinite(r[0])).sum())
        if np.isfinite(m * r[0]).any():
            result[key] = _fit(m, r, turns) | {"stuck_s": max(_stuck_s(pair, name) for pair in pairs)}
    return result


def _lagged(pair: Pair, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Return measured values [F], and recorded ones, shifted by each lag, [L,F]; NaN where not valid."""
    m, r = (np.where(labels.valid, getattr(labels, name), np.nan) for labels in (pair.measured, pair.recorded))
    return m, np.stack([np.interp(pair.time_s + lag_s, pair.time_s, r, np.nan, np.nan) for lag_s in LAGS_S])


def _stuck_s(pair: Pair, name: str) -> float:
    longest, values = 0.0, getattr(pair.recorded, name)
    for rows in np.split(np.arange(len(values)), np.flatnonzero(np.diff(values) != 0) + 1):  # NaN differs from NaN
        moved = pair.measured.steering_rad[rows][pair.measured.valid[rows]]
        if len(moved) and np.ptp(moved) > STUCK_RAD:
            longest = max(longest, float(np.ptp(pair.time_s[rows])))
    return longest


def _fit(m: np.ndarray, r: np.ndarray, turns: np.ndarray) -> dict[str, Any]:
    """Return how recorded values r [L,N] at all lags follow measured ones m [N]; `turns` bool [N].

    ``frames``; ``correlation``, 0 on a steady curve or at a steady speed; ``lag_s`` of the recording, positive if it is
    late, at which the correlation has the largest magnitude, ``best``; ``distinct``: it explains much more than any of
    the other sign, and its magnitude is above 0.7; there ``gain``, recorded / measured root mean square, ``offset``,
    the recorded value where the measured one is 0, and ``off_centre``, the same in measured root mean squares.
    ``cosine``: of both values in turning frames, without lag; ``magnitude``: the best correlation of the recording with
    measured magnitudes; ``thirds_s``: the lag of each third that follows and has SIGNED turning frames.
    """
    correlation, slope, mean_m, mean_r, rms_m, rms_r = _correlation(m, r)
    best = int(np.argmax(np.abs(correlation)))
    rival = max(0.0, (-np.sign(correlation[best]) * correlation).max())
    used, thirds_s = turns & np.isfinite(r[0]), []
    length = math.sqrt((m[used] ** 2).sum() * (r[0, used] ** 2).sum())
    for rows in np.array_split(np.arange(len(m)), 3):
        third = _correlation(m[rows], r[:, rows])[0]
        if used[rows].sum() >= SIGNED and third.max() > CLEAR:
            thirds_s.append(float(LAGS_S[np.argmax(third)]))
    return {
        "frames": int((np.isfinite(m) & np.isfinite(r[0])).sum()),
        "correlation": float(correlation[0]),
        "lag_s": float(LAGS_S[best]),
        "best": float(correlation[best]),
        "distinct": bool(1 - correlation[best] ** 2 < (1 - rival**2) / 2),
        "gain": float(max(rms_r[best], 1e-6) / max(rms_m[best], 1e-6)),
        "offset": (offset := float((mean_r - slope * mean_m)[best])),
        "off_centre": offset / max(float(rms_m[best]), 1e-6),
        "cosine": float((m[used] * r[0, used]).sum() / length) if length else 0.0,
        "magnitude": float(_correlation(np.abs(m), r)[0].max()),
        "thirds_s": thirds_s,
    }


def _correlation(m: np.ndarray, r: np.ndarray) -> np.ndarray:
    """Return correlation, slope of r by m, both means and both root mean squares at each lag, [6,L]."""
    used = np.isfinite(m) & np.isfinite(r)
    count, both = used.sum(axis=1), (np.where(used, m, 0.0), np.where(used, r, 0.0))
    (mean_m, mean_r), (mm, rr) = ([(x**n).sum(axis=1) / np.maximum(count, 1) for x in both] for n in (1, 2))
    mr = (both[0] * both[1]).sum(axis=1) / np.maximum(count, 1) - mean_m * mean_r
    var_m, var_r = mm - mean_m**2, rr - mean_r**2
    varies = (var_m > STEADY**2 * mm) & (var_r > STEADY**2 * rr) & (count > count[0] / 2)
    correlation = np.where(varies, mr, 0.0) / np.sqrt(np.where(varies, var_m * var_r, 1.0))
    slope = np.where(varies, mr, 0.0) / np.where(varies, var_m, 1.0)
    return np.stack([correlation, slope, mean_m, mean_r, np.sqrt(mm), np.sqrt(rr)])


def check(source: str, drives: Mapping[str, Pair]) -> Iterator[str]:
    """Yield what :func:`judge` finds in each long drive, since they may differ, and in all drives.

    Raises InputError for an error.
    """
    compared = {drive: compare([pair]) for drive, pair in drives.items()}
    groups = {drive: found for drive, found in compared.items() if found["turning"] >= JUDGED}
    for where, found in {**groups, "all compared drives": compare([*drives.values()])}.items():
        errors, lines = judge(found, sources.column(source))
        if errors:
            raise InputError(errors[0], where, "Correct the log and import it again, or choose another labels.source")
        yield from (f"{'doubt: ' * (number > 0)}{where}: {line}" for number, line in enumerate(lines))


def judge(comparison: Mapping[str, Any], column: str, ratio: float = 1.0) -> tuple[list[str], list[str]]:
    """Return errors, and lines: a result of :func:`compare`, and up to MOST doubts, the strongest first.

    `column` of the recorded angles, in the log times `ratio`; empty: they follow from yaw rate and speed. With few
    turning frames errors are doubts, with very few there is nothing but the speed.
    """
    errors, doubts, texts, turning = list[str](), list[str](), list[str](), comparison["turning"]
    for key in ("yaw_rate", "angle"):
        if (fit := comparison.get(key)) and turning >= SHOWN:
            late = f", the recording {abs(fit['lag_s']):.2f} s {'late' if fit['lag_s'] > 0 else 'early'}"
            course = f", correlation {fit['correlation']:.3f}{late if fit['lag_s'] else ''}" if fit["best"] else ""
            texts.append(f"{key.replace('_', ' ')} gain {fit['gain']:.2f}{course}")
    key, name = ("angle", column) if column else ("yaw_rate", "yaw_rate_radps")
    if (fit := comparison.get(key)) and turning >= SHOWN:
        errors, doubts = _judge(fit, name, turning, ratio)
    if (speed := comparison.get("speed")) and speed["frames"] >= SHOWN:
        texts.append(f"speed gain {speed['gain']:.2f}")
        if abs(math.log(speed["gain"])) > UNLIKE_SPEED * (1.4 if speed["frames"] < JUDGED else 1):  # noisy
            causes = "km/h would give 3.6, mph 2.24; a wrong K or camera height changes the measured speed"
            doubts.append(f"speed_mps is {speed['gain']:.2f} times what is measured: {causes}")
    agreement = [f"recorded / measured, {turning} turning frames: {'; '.join(texts)}"] if texts else []
    return errors, [*agreement, *doubts[:MOST]]


def _judge(fit: Mapping[str, Any], name: str, turning: int, ratio: float) -> tuple[list[str], list[str]]:
    """Return errors and doubts about the column `name`: the first that holds, and a time that is wrong besides."""
    best, gain, lag_s, many = fit["best"], fit["gain"], fit["lag_s"], turning >= JUDGED
    certain, follows = fit["distinct"] and (many or abs(best) > CLEAR), abs(best) > FOLLOWS
    unsigned = fit["magnitude"] > max(CLEAR, abs(best) + MAGNITUDE)
    inverted = certain and max(best, fit["correlation"]) < 0
    opposite = turning >= SIGNED and fit["cosine"] < OPPOSITE
    degrees = certain and abs(abs(math.log(gain, DEGREES)) - 1) < SIMILAR
    drifts = len(fit["thirds_s"]) > 1 and np.ptp(fit["thirds_s"]) > DRIFT_S
    off_centre = abs(fit["off_centre"]) > OFF_CENTRE
    unlike, others = (
        (UNLIKE_YAW, "and K or --fov") if name == "yaw_rate_radps" else (UNLIKE, "the steering ratio and K")
    )
    times = f"{name} is {gain:.3g} times what is measured"
    lags = " to ".join(f"{lag:.2f}" for lag in fit["thirds_s"])
    causes = "another drive's log, a clock that is more than 2 s off, or poorly measured motion"
    sign, unit = f"the sign of {name} is inverted: left is positive", f"{times}: convert degrees to radians, once"
    errors = [(sign, not unsigned and (opposite or (many and inverted))), (unit, many and degrees)]
    doubts = [
        (f"{name} has angles without a sign", unsigned),
        (sign, inverted),
        (unit, degrees),
        (f"{name} stays equal for {fit['stuck_s']:.0f} s while the car turns", fit["stuck_s"] > STUCK_S),
        (f"the clock of {name} drifts or jumps, or --fps is wrong: it is {lags} s late", drifts),
        (f"{name} does not follow the measured motion: {causes}", many and 0 < abs(best) <= FOLLOWS),
        (f"{times}: check its unit, {others}", certain and follows and abs(math.log(gain)) > unlike),
        (f"straight ahead is {fit['offset'] * ratio:.2g} in {name}: subtract it", follows and off_centre),
    ]
    found = [text for text, holds in doubts if holds][:1]
    if best > CLEAR and best - fit["correlation"] > LATE_COST and abs(lag_s) > LATE_S and not drifts:
        late = "late" if lag_s > 0 else "early"
        found.append(f"{name} is {abs(lag_s):.2f} s {late}: pass --offset {-lag_s:.2f}, added to an earlier one")
    wrong = [text for text, holds in errors if holds]
    return wrong, [] if wrong else found
