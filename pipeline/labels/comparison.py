"""Compare labels from two sources: errors of measured motion, and faults of what was recorded."""

import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.base.errors import InputError
from pipeline.base.store import DriveReader
from pipeline.labels import source as sources
from pipeline.labels.label import TURNING_RAD, Car, Labels, held
from pipeline.metrics import nmse

LAGS_S = np.array(sorted(np.arange(-40, 41) / 20, key=abs))  # [L]
STEADY = 0.2  # standard deviation / root mean square: below, no correlation is defined
SHOWN, JUDGED = 20, 100  # turning frames that a comparison and an error need
CLEAR = 0.9  # correlation that needs fewer frames
# KITTI's and rendered drives agree to 0.05 s with a correlation of 0.997, of which a lag of 0.25 s costs 0.02. A
# steering wheel may lead the yaw rate by 0.2 s.
LATE_S, LATE_COST = 0.2, 0.01
DEGREES, SIMILAR = math.degrees(1), 0.1  # 57.3 within a factor of 1.5: healthy gains are 0.7 to 1.2
# Logarithms of gains. Karlsruhe's cameras measure 1.2 times the speed, a camera 1.2 m above the road 1.38 times. The
# yaw rate depends on no scale, but on the focal length: in 243 rendered drives its gain is 0.93 to 1.07.
UNLIKE, UNLIKE_SPEED, UNLIKE_YAW = math.log(2), math.log(1.4), math.log(1.15)


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


def sums(time_s: np.ndarray, recorded: Labels, measured: Labels) -> np.ndarray:
    """Return sums over the frames [F] of a drive, float64 [3,7,L], for :func:`compare`; those of drives can be added.

    `measured`: means that look ahead. The recording is shifted by each lag; frames count where both are valid.
    """
    result = np.zeros((3, 7, len(LAGS_S)))
    for row, name in enumerate(("steering_rad", "yaw_rate_radps", "speed_mps") if len(time_s) else ()):
        m, r = (np.where(labels.valid, getattr(labels, name), np.nan) for labels in (measured, recorded))
        r = np.stack([np.interp(time_s + lag_s, time_s, r, np.nan, np.nan) for lag_s in LAGS_S])
        used = np.isfinite(m) & np.isfinite(r)
        m, r = np.where(used, m, 0.0), np.where(used, r, 0.0)
        result[row] = np.stack([used, m, r, m * m, r * r, m * r, np.abs(m) > TURNING_RAD]).sum(axis=-1)
    return result


def read(source: str, drives: Sequence[str], ingest: Path, motion: Path, car: Car) -> dict[str, np.ndarray]:
    """Return drive → :func:`sums`, without drives that lack the recorded `source` or measured motion.

    `ingest`, `motion`: the folders of these stages.
    """
    result = {}
    for drive in drives:
        path = motion / f"{drive}.h5"
        with DriveReader(ingest / f"{drive}.h5", stage="ingest") as raw:
            recorded = sources.recorded(raw, car).get(source)
            if recorded and path.is_file():
                result[drive] = sums(raw.time_s, recorded, sources.read("visual", raw, path, car))
    return result


def compare(drives: Sequence[np.ndarray]) -> dict[str, Any]:
    """Return how recorded values follow measured ones, by the :func:`sums` of drives.

    ``turning``: frames that turn by the measured angle. ``angle``, ``yaw_rate`` and ``speed``, where recorded:
    ``frames``; ``correlation``, 0 on a steady curve or at a steady speed; ``lag_s`` of the recording, positive if it is
    late, at which the correlation has the largest magnitude, ``best``; ``distinct``: it explains much more than any of
    the other sign, and its magnitude is above 0.7; ``gain``: recorded / measured root mean square there.
    """
    total, fits = np.sum([np.zeros((3, 7, len(LAGS_S))), *drives], axis=0), dict[str, Any]()
    for name, (count, *means, _) in zip(("angle", "yaw_rate", "speed"), total, strict=True):
        m, r, mm, rr, mr = np.array(means) / np.maximum(count, 1)
        varies = (mm - m**2 > STEADY**2 * mm) & (rr - r**2 > STEADY**2 * rr) & (count > count[0] / 2)
        correlation = np.where(varies, mr - m * r, 0.0) / np.sqrt(np.where(varies, (mm - m**2) * (rr - r**2), 1.0))
        best = int(np.argmax(np.abs(correlation)))
        rival = max(0.0, (-np.sign(correlation[best]) * correlation).max())
        if count[0]:
            fits[name] = {
                "frames": int(count[0]),
                "correlation": float(correlation[0]),
                "lag_s": float(LAGS_S[best]),
                "best": float(correlation[best]),
                "distinct": bool(1 - correlation[best] ** 2 < (1 - rival**2) / 2),
                "gain": float(np.sqrt(max(rr[best], 1e-12) / max(mm[best], 1e-12))),
            }
    return fits | {"turning": int(total[0, 6, 0])}


def check(source: str, drives: Mapping[str, np.ndarray]) -> Iterator[str]:
    """Yield what :func:`judge` finds in the :func:`sums` of each long drive, since they may differ, and of all drives.

    Raises InputError for an error.
    """
    long = {drive: [own] for drive, own in drives.items() if own[0, 6, 0] >= JUDGED}
    for where, group in {**long, "training and validation drives": [*drives.values()]}.items():
        errors, lines = judge(compare(group), sources.column(source))
        if errors:
            raise InputError(errors[0], where, "Correct the log and import it again, or choose another labels.source")
        yield from (f"{where}: {line}" for line in lines)


def judge(comparison: Mapping[str, Any], column: str) -> tuple[list[str], list[str]]:
    """Return errors, and lines: a result of :func:`compare`, and doubts.

    `column` of the recorded angles; empty: they follow from yaw rate and speed. With few turning frames errors are
    doubts, with very few there is nothing but the speed.
    """
    errors, doubts, texts, turning = list[str](), list[str](), list[str](), comparison["turning"]
    angle = column, "angle", UNLIKE, "the steering ratio and K"
    for name, key, unlike, others in (("yaw_rate_radps", "yaw_rate", UNLIKE_YAW, "and K or --fov"), angle):
        if not (fit := comparison.get(key)) or turning < SHOWN:
            continue
        _, correlation, lag_s, best, distinct, gain = fit.values()
        course = f", correlation {correlation:.3f}, best lag {lag_s:.2f} s" if best else ""
        texts.append(f"{key.replace('_', ' ')} gain {gain:.2f}{course}")
        if not name or errors:
            continue
        certain, found = (distinct, errors) if turning >= JUDGED else (distinct and abs(best) > CLEAR, doubts)
        times = f"{name} is {gain:.3g} times what is measured"
        if certain and max(best, correlation) < 0:
            found.append(f"the sign of {name} is inverted: left is positive")
        if certain and abs(abs(math.log(gain, DEGREES)) - 1) < SIMILAR:
            found.append(f"{times}: convert degrees to radians, once")
        elif certain and abs(math.log(gain)) > unlike - math.log(abs(best)):  # noise increases either
            doubts.append(f"{times}: check its unit, {others}")
        elif best and not certain and turning >= JUDGED:
            causes = "another drive's log, a clock that is more than 2 s off, or poorly measured motion"
            doubts.append(f"{name} does not follow the measured motion: {causes}")
        if best > CLEAR and best - correlation > LATE_COST and abs(lag_s) > LATE_S:
            when = "late" if lag_s > 0 else "early"
            doubts.append(f"{name} is {abs(lag_s):.2f} s {when}: pass --offset {-lag_s:.2f}, added to an earlier one")
    if (speed := comparison.get("speed")) and speed["frames"] >= SHOWN:
        texts.append(f"speed gain {speed['gain']:.2f}")
        if abs(math.log(speed["gain"])) > UNLIKE_SPEED * (1.4 if speed["frames"] < JUDGED else 1):  # noisy
            causes = "km/h would give 3.6, mph 2.24; a wrong K or camera height changes the measured speed"
            doubts.append(f"speed_mps is {speed['gain']:.2f} times what is measured: {causes}")
    return errors, [f"recorded / measured, {turning} turning frames: {'; '.join(texts)}", *doubts] if texts else []
