"""Compare the logs of a recording with its images: times, the sign of values, and the clock."""

from pathlib import Path

import numpy as np

from pipeline.base.errors import InputError
from pipeline.ingest.datasets.recording import open_part, usable
from pipeline.ingest.recording import Recording
from pipeline.ingest.settings import Part
from pipeline.labels.agreement import Noise, Pair, compare
from pipeline.labels.comparison import TURNING_FRAMES, UNKNOWN, judge_turns
from pipeline.labels.label import TURNING_RAD, Labels, steering_angle
from pipeline.motion.horizon import turn_rates
from pipeline.motion.speed import TYPICAL_MPS

# Standard deviation in rad/s of a yaw rate that is measured from the rotation between two images.
# On five real recordings it is 0.010 to 0.016.
TURN_SIGMA_RADPS = 0.012
# Wheelbase in metres of a typical car, by which a yaw rate at a typical speed becomes an angle.
CAR_M = 2.7


def check_recording_logs(part: Part, folder: Path) -> None:
    """Check the logs of a recording from start to end of a `part`, as steer import does.

    The recording's files are in `folder`. To check all parts of a recording at once, pass a part
    that spans them all. Raises InputError for a log that cannot be read, is of another time than
    the images, or has a wrong sign or clock. Raises it also if no image of the part has a logged
    motion.
    """
    check_logs(open_part(part, folder), part.start, part.end)


def check_logs(recording: Recording, start_s: float, end_s: float | None) -> np.ndarray:
    """Compare a recording's logs with the turns of its images from start to end.

    A note is added to the recording if the car turns in too few images to compare the log, or to
    train on it. Returns which images lie
    between start and end and have a logged motion, bool [F]; if there is no log of the motion, only
    the time counts. Raises InputError if the sign or the clock of a log is wrong, or if there is no
    such image.
    """
    time_s = recording.times_s
    if recording.logs:
        _compare_turns(recording, usable(time_s, {}, start_s, end_s))
    used = usable(time_s, recording.logs, start_s, end_s)
    if not used.any():
        problem = "no image from --start to --end is left, or none with motion"
        raise InputError(problem, fix="Change --start, --end or --offset")
    return used


def _compare_turns(recording: Recording, within: np.ndarray) -> None:
    """Compare the logs with the turns of those images that `within`, bool [F], selects."""
    time_s = recording.times_s
    unknown = np.full(len(time_s), np.nan)

    # The images give no speed, so a wheel's angle is compared with a car's at a typical speed.
    measured_radps = turn_rates(recording.frames, recording.camera, time_s, within)
    measured = _labels(measured_radps * CAR_M / TYPICAL_MPS, measured_radps)
    noise = Noise(np.full(len(time_s), TURN_SIGMA_RADPS), unknown)

    for kind, log in recording.logs.items():
        values = log.at(time_s)
        if kind == "motion":
            column = "yaw_rate_radps"
            speed_mps, yaw_rate_radps = values
            recorded = _labels(unknown, yaw_rate_radps)
            angle_rad = steering_angle(yaw_rate_radps, speed_mps, CAR_M)
        else:
            column = "wheel_rad"
            speed_mps = unknown
            angle_rad = values[0]
            recorded = _labels(angle_rad, unknown)
        turning = int(np.sum(np.abs(angle_rad[within]) > TURNING_RAD))
        if turning < TURNING_FRAMES:
            text = f"{turning} of {int(within.sum())} images turn by {log.name}"
            recording.notes.append(f"{text} (radius below 135 m): too few to train on")

        agreement = compare([Pair(time_s, recorded, measured, noise)])
        problem, fix = judge_turns(agreement, column, speed_mps[within])
        if problem == UNKNOWN:
            text = f"{log.name} cannot be compared with the turns of the images: {problem}"
            recording.notes.append(text)
        elif problem:
            raise InputError(problem, log.name, fix)


def _labels(steering_rad: np.ndarray, yaw_rate_radps: np.ndarray) -> Labels:
    """Return labels [F] with unknown speeds. Arguments are NaN where unknown."""
    valid = np.isfinite(steering_rad) | np.isfinite(yaw_rate_radps)
    return Labels(steering_rad, valid, np.full(len(valid), np.nan), yaw_rate_radps)
