"""Compare recorded labels with measured motion: faults of what was recorded."""

import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from pipeline.base.errors import InputError
from pipeline.base.store import DriveReader
from pipeline.labels import source as sources
from pipeline.labels.agreement import MOVES_MPS, Agreement, Fit, Noise, Pair, Speed, compare
from pipeline.labels.label import Car
from pipeline.motion.rates import measured_rates

# Turning frames that a comparison needs.
SHOWN = 20
# Turning frames from which an inverted sign is an error.
SIGNED = 40
# Turning frames from which a wrong unit is an error, and a drive is compared alone.
JUDGED = 100
# The cosine of recorded and measured values, of turning frames, is 0.97 to 1 in all parts of eight
# healthy logs that have SIGNED turning frames; where the sign is inverted, it is the opposite.
OPPOSITE = -0.93
# Largest lag in seconds of an inverted log: beyond, a late log of a winding road looks the same.
TURNED_S = 0.6
# KITTI's and rendered drives agree to 0.05 s with a correlation of 0.997, of which a lag of 0.25 s
# costs 0.02. A steering wheel may lead the yaw rate by 0.2 s.
LATE_S = 0.2
LATE_COST = 0.01
# Least lag that is printed: of healthy logs, what it gains is noise.
PRINTED_COST = 0.002
# Largest difference in seconds of the lags of the thirds of a log: healthy ones have up to 0.1.
DRIFT_S = 0.3
# Frames that turn to one side, in which a log without signs has the other one.
OTHER_SIDE = 10
# Least correlation of a log without signs with the magnitudes of the measured values.
CLEAR = 0.8
# Longest time for which a healthy log stays equal while the car turns.
STUCK_S = 2.0
# A unit is degrees if the logarithm of the gain to this base is within SIMILAR of 1: 57.3 within a
# factor of 2.
DEGREES = math.degrees(1)
SIMILAR = 0.17
# Logarithms of gains. Karlsruhe's cameras measure 1.2 times the speed, a camera 1.2 m above the
# road 1.38 times. The yaw rate depends on no scale, but on the focal length: in 243 rendered drives
# its gain is 0.93 to 1.07.
UNLIKE = math.log(1.3)
UNLIKE_SPEED = math.log(1.4)
UNLIKE_YAW = math.log(1.15)
# Standard deviations of the measured speed that its errors may reach besides.
SIGMAS = 2.0
# Share of the frames whose speed has the wrong sign, beyond which the log's sign is inverted.
NEGATIVE = 0.5
# Why a log cannot be compared.
UNKNOWN = "too little turning for its noise"
# Doubts that are shown about one recording.
MOST = 2


def read(
    source: str, drives: Sequence[str], ingest: Path, motion: Path, car: Car
) -> dict[str, Pair]:
    """Return drive → labels, without drives that lack the recorded `source` or measured motion.

    `ingest`, `motion`: the folders of these stages.
    """
    result = {}
    for drive in drives:
        path = motion / f"{drive}.h5"
        with DriveReader(ingest / f"{drive}.h5", stage="ingest") as raw:
            recorded = sources.recorded(raw, car).get(source)
            if recorded and path.is_file():
                measured = sources.read("visual", raw, path, car)
                result[drive] = Pair(raw.time_s, recorded, measured, read_noise(raw, path))
    return result


def read_noise(raw: DriveReader, motion: Path) -> Noise:
    """Return the standard deviations of the measured rates of an ingest file's frames."""
    sigmas = np.full((2, len(raw.frame)), np.nan)
    with DriveReader(motion, stage="motion") as file:
        rows = np.searchsorted(raw.frame, file.frame)
        sigmas[:, rows] = measured_rates(file, look_ahead=True)[2:]
    return Noise(*sigmas)


def check(source: str, drives: Mapping[str, Pair]) -> Iterator[str]:
    """Yield what :func:`judge` finds in each long drive, since they may differ, and in all drives.

    Raises InputError for an error.
    """
    compared = {drive: compare([pair]) for drive, pair in drives.items()}
    groups = {
        drive: found
        for drive, found in compared.items()
        if found.turning >= JUDGED or len(drives) == 1
    }
    if len(drives) > 1:
        groups["all compared drives"] = compare([*drives.values()])
    for where, found in groups.items():
        errors, lines = judge(found, sources.column(source))
        if errors:
            raise InputError(
                errors[0],
                where,
                "Correct the log and import it again, or choose another labels.source",
            )
        yield from (
            f"{'doubt: ' * (number > 0)}{where}: {line}" for number, line in enumerate(lines)
        )


def judge(agreement: Agreement, column: str, ratio: float = 1.0) -> tuple[list[str], list[str]]:
    """Return errors, and lines: a summary, and up to MOST doubts, the strongest first.

    `column` of the recorded angles, in the log times `ratio`; empty: they follow from yaw rate and
    speed. With few turning frames errors are doubts, with very few there is nothing but the speed.
    """
    errors = list[str]()
    doubts = list[str]()
    if agreement.speed:
        errors, doubts = _judge_speed(agreement.speed, agreement.speed_sigma, column)

    fit = agreement.angle if column else agreement.yaw_rate
    of_fit = list[str]()
    if fit and fit.turning >= SHOWN and not errors:
        errors, of_fit = _judge(fit, column or "yaw_rate_radps", ratio, agreement.speed_sigma)
    unknown = fit is not None and not (_comparable(fit) or errors or of_fit)
    summary = _summary(agreement, "angle" if column else "yaw rate", unknown)
    return errors, [*summary, *(of_fit + doubts)[:MOST]]


def judge_turns(agreement: Agreement, column: str, speed_mps: np.ndarray) -> tuple[str, str]:
    """Return an error of a log's sign or clock by the turns of images alone, and a fix; or UNKNOWN,
    or empty texts.

    `column`: the one that was compared; `speed_mps`: recorded, NaN where unknown, of which images
    tell the sign alone. Pairs of images are independent of each other, so SHOWN of them suffice.
    """
    if np.sum(speed_mps < -MOVES_MPS) > np.sum(speed_mps > MOVES_MPS):
        return "speed_mps is negative in most images: forward is positive", ""
    fit = agreement.yaw_rate or agreement.angle
    if not fit or not _comparable(fit):
        return UNKNOWN, ""
    if fit.far_s is not None:
        return _wrong_clock(column, fit.far_s), ""
    sign = _wrong_sign(column, fit)
    if sign and fit is agreement.angle:
        return sign, "A negative --steering-ratio inverts it"
    return sign, ""


def _wrong_clock(name: str, lag_s: float) -> str:
    return f"the clock of {name} is {_late(lag_s)}: {_offset(lag_s)}"


def _wrong_sign(name: str, fit: Fit) -> str:
    """Return a message if the sign of a column is inverted, else an empty text."""
    inverted = fit.follows and fit.best < 0 and abs(fit.lag_s) <= TURNED_S
    opposite = fit.turning >= SIGNED and fit.cosine < OPPOSITE
    if not (inverted or opposite):
        return ""
    also = ". Or its angles have no sign" if fit.one_sided else ""
    return f"the sign of {name} is inverted: left is positive{also}"


def _summary(agreement: Agreement, judged: str, unknown: bool) -> list[str]:
    """Return a line on gains, correlations and lags; `unknown`: what is `judged` has too little
    turning for them.
    """
    texts = list[str]()
    for name, fit in (("yaw rate", agreement.yaw_rate), ("angle", agreement.angle)):
        if not fit or fit.turning < SHOWN:
            continue
        text = f"{name} gain {fit.gain:.2f}"
        if fit.best:
            text += f", correlation {fit.correlation:.3f}"
        if fit.follows and fit.lag_gain > PRINTED_COST:
            text += f", the log {_late(fit.lag_s)}"
        texts.append(text)
    if unknown:
        texts = [f"{judged} cannot be compared: {UNKNOWN}"]
    if agreement.speed and agreement.speed.frames >= SHOWN:
        texts.append(f"speed gain {agreement.speed.gain:.2f}")
    if not texts:
        return []
    return [f"recorded / measured, {agreement.turning} turning frames: {'; '.join(texts)}"]


def _comparable(fit: Fit) -> bool:
    """Return whether a log of another road, or with another sign, would differ in the frames that
    turn.
    """
    tells = fit.judged or fit.follows or abs(fit.cosine) > -OPPOSITE
    return tells and fit.turning >= SHOWN


def _late(lag_s: float) -> str:
    return f"{abs(lag_s):.2f} s {'late' if lag_s > 0 else 'early'}"


def _offset(lag_s: float) -> str:
    return f"pass --offset {-lag_s:.2f}, added to an earlier one"


def _judge_speed(speed: Speed, sigma: float, column: str) -> tuple[list[str], list[str]]:
    """Return errors and doubts about recorded speeds, from which angles follow unless they have a
    `column`.
    """
    doubts = list[str]()
    if speed.back > NEGATIVE * speed.frames >= NEGATIVE * SHOWN:
        problem = (
            f"speed_mps is negative in {speed.back} of {speed.frames} frames that are measured "
            "ahead"
        )
        if not column:
            return [f"{problem}, so angles have the wrong sign: forward is positive"], []
        doubts.append(f"{problem}: forward is positive")
    if speed.ahead:
        text = f"{speed.ahead} frames go ahead by speed_mps, but are measured backwards"
        text += ": a speed without a sign in reverse gear?"
        if not column:
            text += " Stage labels gives them no label"
        doubts.append(text)
    if 0 < speed.back <= NEGATIVE * speed.frames:
        doubts.append(f"{speed.back} frames go backwards by speed_mps, but are measured ahead")
    noisy = 1.4 if speed.frames < JUDGED else 1.0
    if speed.frames >= SHOWN and abs(math.log(speed.gain)) > UNLIKE_SPEED * noisy + SIGMAS * sigma:
        causes = (
            "km/h would give 3.6, mph 2.24; a wrong K or camera height changes the measured speed"
        )
        doubts.append(f"speed_mps is {speed.gain:.2f} times what is measured: {causes}")
    return [], doubts


def _judge(fit: Fit, name: str, ratio: float, speed_sigma: float) -> tuple[list[str], list[str]]:
    """Return errors and doubts about the column `name`: the first that holds, and a time that is
    wrong besides.
    """
    many = fit.turning >= JUDGED
    if fit.far_s is not None:
        return [], [_wrong_clock(name, fit.far_s)]
    sign = _wrong_sign(name, fit)
    if sign:
        return ([sign], []) if fit.turning >= SIGNED else ([], [sign])
    if fit.stuck_s > STUCK_S:
        return [], [f"{name} stays equal for {fit.stuck_s:.0f} s while the car turns"]
    if fit.other_side >= OTHER_SIDE and fit.magnitude > max(CLEAR, fit.best):
        return [], [f"{name} has angles without a sign"]

    follows = fit.follows and fit.best > 0
    times = f"{name} is {fit.gain:.3g} times what is measured"
    if (follows or fit.cosine > -OPPOSITE) and abs(abs(math.log(fit.gain, DEGREES)) - 1) < SIMILAR:
        unit = f"{times}: convert degrees to radians, once"
        return ([unit], []) if many else ([], [unit])
    if len(fit.thirds_s) > 1 and np.ptp(fit.thirds_s) > DRIFT_S:
        lags = " to ".join(f"{lag:.2f}" for lag in fit.thirds_s)
        return [], [f"the clock of {name} drifts or jumps, or --fps is wrong: it is {lags} s late"]
    steady = fit.best == 0 and fit.cosine > -OPPOSITE  # a bend in which the recording hardly varies
    if steady:
        return [], []
    if not follows:
        causes = "another drive's log, a clock that is far off, or poorly measured motion"
        return [], [f"{name} does not follow the measured motion: {causes}"] if fit.judged else []

    doubts = list[str]()
    others = "the steering ratio and K"
    unlike = UNLIKE + SIGMAS * speed_sigma
    if name == "yaw_rate_radps":
        others = "and K or --fov"
        unlike = UNLIKE_YAW
    # noise changes a gain by up to the correlation
    if abs(math.log(fit.gain)) > unlike - math.log(fit.best):
        doubts.append(f"{times}: check its unit, {others}")
    elif fit.off_centre:
        doubts.append(f"straight ahead is {fit.offset * ratio:.2g} in {name}: subtract it")
    if fit.lag_gain > LATE_COST and abs(fit.lag_s) > LATE_S:
        doubts.append(f"{name} is {_late(fit.lag_s)}: {_offset(fit.lag_s)}")
    return [], doubts
