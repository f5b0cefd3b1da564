"""Compare recorded labels with measured motion, and report the faults of a recording.

A fault is certain, and a doubt is not. Both are messages to users.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from pipeline.base.errors import InputError
from pipeline.base.store import DriveReader
from pipeline.labels import source as sources
from pipeline.labels.agreement import MOVES_MPS, Agreement, Fit, Noise, Pair, Speed, compare
from pipeline.labels.label import Car
from pipeline.motion.rates import measured_rates

# Least number of turning frames at which turns are compared.
TURNING_FRAMES = 20
# Least number of turning frames at which an inverted sign is a fault. With fewer, it is a doubt.
SIGN_FRAMES = 40
# Least number of turning frames at which a wrong unit is a fault. With fewer, it is a doubt. Drives
# that have as many are also compared one by one.
UNIT_FRAMES = 100
# Cosine similarity of recorded and measured values in turning frames below which the sign is
# inverted. In parts of eight healthy logs with SIGN_FRAMES turning frames, it is 0.97 to 1.
OPPOSITE_COSINE = -0.93
# Largest lag in seconds of an inverted log. On a winding road, a log that is later than this looks
# like an inverted one.
INVERTED_LAG_S = 0.6
# Largest lag in seconds of a healthy log. KITTI's and rendered drives agree to 0.05 s; a steering
# wheel may lead the yaw rate by 0.2 s.
LATE_S = 0.2
# Loss of correlation above which a lag is a doubt. KITTI's and rendered drives have a correlation
# of 0.997, and lose 0.02 by a lag of 0.25 s.
LATE_COST = 0.01
# Loss of correlation above which a lag is printed. In healthy logs, smaller losses are noise.
PRINTED_COST = 0.002
# Largest difference in seconds between the lags of a log's thirds. Healthy logs have up to 0.1.
DRIFT_S = 0.3
# Least number of frames that are measured to turn right if a log without signs has only values to
# the left, or the other way round.
OTHER_SIDE_FRAMES = 10
# Correlation with the magnitudes of the measured values that a log without signs exceeds.
UNSIGNED_CORRELATION = 0.8
# Longest time in seconds for which a healthy log stays equal while the car turns.
STUCK_S = 2.0
# Gain of a log in degrees, if radians are expected.
DEGREES = math.degrees(1)
# Largest difference between the logarithms of such a gain and of DEGREES, both to the base DEGREES.
# It allows for a factor of 2.
DEGREES_ERROR = 0.17
# Largest magnitude of the logarithm of a healthy angle's gain. Karlsruhe's cameras measure 1.2
# times the speed.
UNLIKE_ANGLE = math.log(1.3)
# Largest magnitude of the logarithm of a healthy speed's gain. A camera 1.2 m above the road
# measures 1.38 times the speed.
UNLIKE_SPEED = math.log(1.4)
# Largest magnitude of the logarithm of a healthy yaw rate's gain. This gain depends on the focal
# length, but not on the scale of depth. In 243 rendered drives, it is 0.93 to 1.07.
UNLIKE_YAW_RATE = math.log(1.15)
# Factor by which UNLIKE_SPEED is larger in fewer than UNIT_FRAMES frames.
FEW_FRAMES_FACTOR = 1.4
# Number of the measured speed's standard deviations that are added to the largest logarithms of
# angles and speeds.
SPEED_SIGMAS = 2.0
# Share of the frames whose speed has the wrong sign, beyond which the log's sign is inverted.
NEGATIVE_SHARE = 0.5
# Reason why a log cannot be compared.
UNKNOWN = "too little turning for its noise"
# Largest number of doubts that are shown about one recording.
MOST_DOUBTS = 2


class Verdict(NamedTuple):
    """The messages about the values of a log."""

    fault: str = ""  # empty without a fault; with a fault, there are no doubts
    doubts: Sequence[str] = ()


def read_pairs(
    source: str, drives: Sequence[str], ingest: Path, motion: Path, car: Car
) -> dict[str, Pair]:
    """Return drive → recorded and measured labels.

    Drives that lack the recorded `source` or measured motion are left out. `ingest` and `motion`
    are the folders of these stages.
    """
    pairs = {}
    for drive in drives:
        path = motion / f"{drive}.h5"
        with DriveReader(ingest / f"{drive}.h5", stage="ingest") as raw:
            recorded = sources.recorded_labels(raw, car).get(source)
            if recorded and path.is_file():
                measured = sources.make_labels("visual", raw, path, car)
                pairs[drive] = Pair(raw.time_s, recorded, measured, read_noise(raw, path))
    return pairs


def read_noise(raw: DriveReader, motion: Path) -> Noise:
    """Return the standard deviations of the measured rates in the frames of an ingest file."""
    sigmas = np.full((2, len(raw.frame)), np.nan)
    with DriveReader(motion, stage="motion") as file:
        rows = np.searchsorted(raw.frame, file.frame)
        _, _, yaw_sigma_radps, speed_sigma = measured_rates(file, look_ahead=True)
    sigmas[:, rows] = yaw_sigma_radps, speed_sigma
    return Noise(*sigmas)


def check_recorded(source: str, drives: Mapping[str, Pair]) -> Iterator[str]:
    """Yield a summary and doubts about each drive with enough turns, and about all drives.

    Each drive is judged, since one of them alone can be wrong. Raises InputError for a fault.
    """
    column = sources.angle_column(source)
    groups = {}
    for drive, pair in drives.items():
        agreement = compare([pair])
        if agreement.turning >= UNIT_FRAMES or len(drives) == 1:
            groups[drive] = agreement
    if len(drives) > 1:
        groups["all compared drives"] = compare([*drives.values()])

    for where, agreement in groups.items():
        fault, lines = judge(agreement, column)
        if fault:
            fix = "Correct the log and import it again, or choose another labels.source"
            raise InputError(fault, where, fix)
        # The first line is the summary, and the others are doubts.
        for summary in lines[:1]:
            yield f"{where}: {summary}"
        for doubt in lines[1:]:
            yield f"doubt: {where}: {doubt}"


def judge(agreement: Agreement, column: str, ratio: float = 1.0) -> tuple[str, list[str]]:
    """Return a fault or an empty text, and a list of a summary and up to MOST_DOUBTS doubts.

    The strongest doubt comes first. With fewer than TURNING_FRAMES turning frames, only the speed
    is compared.

    Args:
        agreement: how the log agrees with measured motion.
        column: name of the recorded angles in messages; empty if angles follow from yaw rate and
            speed.
        ratio: ratio of the angles in the log to those that were compared, for instance of a
            steering wheel's to the front wheels'.
    """
    speed_verdict = Verdict()
    if agreement.speed:
        speed_verdict = _judge_speed(agreement.speed, agreement.speed_sigma, column)

    # Angles that follow from yaw rate and speed are judged by the yaw rate.
    fit = agreement.angle if column else agreement.yaw_rate
    turns_verdict = Verdict()
    if fit and fit.turning >= TURNING_FRAMES and not speed_verdict.fault:
        name = column or "yaw_rate_radps"
        turns_verdict = _judge_turns(fit, name, ratio, agreement.speed_sigma)

    fault = speed_verdict.fault or turns_verdict.fault
    unknown = fit is not None and not (_comparable(fit) or fault or turns_verdict.doubts)
    summary = _summary(agreement, "angle" if column else "yaw rate", unknown)
    doubts = [*turns_verdict.doubts, *speed_verdict.doubts]
    return fault, summary + doubts[:MOST_DOUBTS]


def judge_turns(agreement: Agreement, column: str, speed_mps: np.ndarray) -> tuple[str, str]:
    """Return a fault of a log's sign or clock, and its fix, if turns were measured without speed.

    Both texts are empty without a fault, and the fix may be empty with one. The fault is UNKNOWN if
    the log cannot be compared. The turns are measured in single pairs of images, which are
    independent of each other, so TURNING_FRAMES of them suffice.

    Args:
        agreement: how the log agrees with these turns.
        column: name of the column that was compared.
        speed_mps: recorded speed, NaN where unknown. Only its sign is judged.
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


def _comparable(fit: Fit) -> bool:
    """Return whether the turns would expose a log of another road or with another sign."""
    tells = fit.judged or fit.follows or abs(fit.cosine) > -OPPOSITE_COSINE
    return tells and fit.turning >= TURNING_FRAMES


def _summary(agreement: Agreement, judged: str, unknown: bool) -> list[str]:
    """Return a list of one line on gains, correlations and lags, or an empty list.

    With `unknown`, the line says that the values named `judged` turn too little to be compared.
    """
    texts = list[str]()
    for name, fit in (("yaw rate", agreement.yaw_rate), ("angle", agreement.angle)):
        if not fit or fit.turning < TURNING_FRAMES:
            continue
        text = f"{name} gain {fit.gain:.2f}"
        if fit.best:
            text += f", correlation {fit.correlation:.3f}"
        if fit.follows and fit.lag_gain > PRINTED_COST:
            text += f", the log {_late(fit.lag_s)}"
        texts.append(text)
    if unknown:
        texts = [f"{judged} cannot be compared: {UNKNOWN}"]
    if agreement.speed and agreement.speed.frames >= TURNING_FRAMES:
        texts.append(f"speed gain {agreement.speed.gain:.2f}")
    if not texts:
        return []
    return [f"recorded / measured, {agreement.turning} turning frames: {'; '.join(texts)}"]


def _judge_speed(speed: Speed, sigma: float, column: str) -> Verdict:
    """Judge recorded speeds, from which angles follow if the log has no `column` of angles.

    `sigma` is the relative standard deviation of the measured speed.
    """
    doubts = list[str]()
    enough = speed.frames >= TURNING_FRAMES
    if enough and speed.back > NEGATIVE_SHARE * speed.frames:
        problem = f"speed_mps is negative in {speed.back} of {speed.frames} frames "
        problem += "that are measured ahead"
        if not column:
            return Verdict(f"{problem}, so angles have the wrong sign: forward is positive")
        doubts.append(f"{problem}: forward is positive")
    if speed.ahead:
        text = f"{speed.ahead} frames go ahead by speed_mps, but are measured backwards"
        text += ": a speed without a sign in reverse gear?"
        if not column:
            text += " Stage labels gives them no label"
        doubts.append(text)
    if 0 < speed.back <= NEGATIVE_SHARE * speed.frames:
        doubts.append(f"{speed.back} frames go backwards by speed_mps, but are measured ahead")

    # A short recording has a less certain gain.
    unlike = UNLIKE_SPEED
    if speed.frames < UNIT_FRAMES:
        unlike = UNLIKE_SPEED * FEW_FRAMES_FACTOR
    if enough and abs(math.log(speed.gain)) > unlike + SPEED_SIGMAS * sigma:
        units = "km/h would give 3.6, mph 2.24"
        causes = f"{units}; a wrong K or camera height changes the measured speed"
        doubts.append(f"speed_mps is {speed.gain:.2f} times what is measured: {causes}")
    return Verdict(doubts=doubts)


def _judge_turns(fit: Fit, name: str, ratio: float, speed_sigma: float) -> Verdict:
    """Judge the column `name`, and return the first fault or doubt that holds.

    Only a log that follows can have a second doubt, which is about its lag.
    """
    # With a wrong clock or sign, or values that do not follow turns, nothing else can be judged.
    if fit.far_s is not None:
        return Verdict(doubts=[_wrong_clock(name, fit.far_s)])
    sign = _wrong_sign(name, fit)
    if sign:
        return _fault_if(fit.turning >= SIGN_FRAMES, sign)
    if fit.stuck_s > STUCK_S:
        text = f"{name} stays equal for {fit.stuck_s:.0f} s while the car turns"
        return Verdict(doubts=[text])
    if fit.other_side >= OTHER_SIDE_FRAMES and fit.magnitude > max(UNSIGNED_CORRELATION, fit.best):
        return Verdict(doubts=[f"{name} has angles without a sign"])

    # The unit may be wrong, or the clock may run at another rate.
    follows = fit.follows and fit.best > 0
    same_side = fit.cosine > -OPPOSITE_COSINE
    is_degrees = abs(abs(math.log(fit.gain, DEGREES)) - 1) < DEGREES_ERROR
    if (follows or same_side) and is_degrees:
        unit = f"{_times(name, fit)}: convert degrees to radians, once"
        return _fault_if(fit.turning >= UNIT_FRAMES, unit)
    if len(fit.thirds_s) > 1 and np.ptp(fit.thirds_s) > DRIFT_S:
        lags = " to ".join(f"{lag:.2f}" for lag in fit.thirds_s)
        text = f"the clock of {name} drifts or jumps, or --fps is wrong: it is {lags} s late"
        return Verdict(doubts=[text])

    # A bend in which the values hardly vary tells nothing else.
    if fit.best == 0 and same_side:
        return Verdict()
    if follows:
        return Verdict(doubts=_doubts_of_following(fit, name, ratio, speed_sigma))
    if fit.judged:
        causes = "another drive's log, a clock that is far off, or poorly measured motion"
        return Verdict(doubts=[f"{name} does not follow the measured motion: {causes}"])
    return Verdict()


def _fault_if(certain: bool, message: str) -> Verdict:
    if certain:
        return Verdict(message)
    return Verdict(doubts=[message])


def _doubts_of_following(fit: Fit, name: str, ratio: float, speed_sigma: float) -> list[str]:
    """Return doubts about a log that follows: about its gain or else its offset, and its lag."""
    doubts = list[str]()
    unlike = UNLIKE_ANGLE + SPEED_SIGMAS * speed_sigma
    causes = "the steering ratio and K"
    if name == "yaw_rate_radps":
        unlike = UNLIKE_YAW_RATE
        causes = "and K or --fov"
    # Noise changes a gain by a factor of up to the correlation.
    if abs(math.log(fit.gain)) > unlike - math.log(fit.best):
        doubts.append(f"{_times(name, fit)}: check its unit, {causes}")
    elif fit.off_centre:
        doubts.append(f"straight ahead is {fit.offset * ratio:.2g} in {name}: subtract it")
    if fit.lag_gain > LATE_COST and abs(fit.lag_s) > LATE_S:
        doubts.append(f"{name} is {_late(fit.lag_s)}: {_offset(fit.lag_s)}")
    return doubts


def _wrong_clock(name: str, lag_s: float) -> str:
    return f"the clock of {name} is {_late(lag_s)}: {_offset(lag_s)}"


def _wrong_sign(name: str, fit: Fit) -> str:
    """Return a message if the sign of a column is inverted, else an empty text."""
    inverted = fit.follows and fit.best < 0 and abs(fit.lag_s) <= INVERTED_LAG_S
    opposite = fit.turning >= SIGN_FRAMES and fit.cosine < OPPOSITE_COSINE
    if not (inverted or opposite):
        return ""
    message = f"the sign of {name} is inverted: left is positive"
    if fit.one_sided:
        message += ". Or its angles have no sign"
    return message


def _times(name: str, fit: Fit) -> str:
    return f"{name} is {fit.gain:.3g} times what is measured"


def _late(lag_s: float) -> str:
    return f"{abs(lag_s):.2f} s {'late' if lag_s > 0 else 'early'}"


def _offset(lag_s: float) -> str:
    return f"pass --offset {-lag_s:.2f}, added to an earlier one"
