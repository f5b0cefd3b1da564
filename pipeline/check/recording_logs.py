"""Compare the logs of a recording with its images: their times, the sign of their values, and their
clock.
"""

from pathlib import Path

import numpy as np

from pipeline.base.errors import InputError
from pipeline.ingest.datasets.recording import open_part, usable
from pipeline.ingest.recording import Recording
from pipeline.ingest.settings import Part
from pipeline.labels.agreement import Noise, Pair, compare
from pipeline.labels.comparison import UNKNOWN, judge_turns
from pipeline.labels.label import Labels
from pipeline.motion.horizon import turn_rates
from pipeline.motion.step import TYPICAL_MPS

# Standard deviation of a yaw rate by the rotation between two images: it is 0.010 to 0.016 on five
# real recordings.
TURN_SIGMA_RADPS = 0.012
# A car's wheelbase, for the angle at a typical speed.
CAR_M = 2.7


def check_recording_logs(part: Part, folder: Path) -> None:
    """Check the logs of a recording whose files are in `folder`, as steer import does, from start
    to end of a `part`.

    To check all parts of a recording at once, pass one that starts with the first and ends with the
    last. Raises InputError for a log that cannot be read, is of another time, or has a wrong sign
    or clock, and for a part of which no image is left.
    """
    check_logs(open_part(part, folder), part.start, part.end)


def check_logs(recording: Recording, start_s: float, end_s: float | None) -> np.ndarray:
    """Compare a recording's logs with its turns from start to end; return which images there have
    logged motion [F].

    A note is added to the recording if too few images turn. The images give no speed: the angle of
    a wheel is compared with a car's at TYPICAL_MPS. Raises InputError if the sign or the clock of a
    log is wrong, or no image is left.
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
    """Compare the logs with the turns of the images `within` some time, bool [F]."""
    time_s = recording.times_s
    measured_radps = turn_rates(recording.frames, recording.camera, time_s, within)
    measured = _labels(measured_radps * CAR_M / TYPICAL_MPS, measured_radps)
    noise = Noise(np.full(len(time_s), TURN_SIGMA_RADPS), np.full(len(time_s), np.nan))
    unknown = np.full(len(time_s), np.nan)
    for kind, log in recording.logs.items():
        values = log.at(time_s)
        if kind == "motion":
            column = "yaw_rate_radps"
            recorded = _labels(unknown, values[1])
            speed_mps = values[0, within]
        else:
            column = "wheel_rad"
            recorded = _labels(values[0], unknown)
            speed_mps = unknown
        problem, fix = judge_turns(
            compare([Pair(time_s, recorded, measured, noise)]), column, speed_mps
        )
        if problem == UNKNOWN:
            recording.notes.append(
                f"{log.name} cannot be compared with the turns of the images: {problem}"
            )
        elif problem:
            raise InputError(problem, log.name, fix)


def _labels(steering_rad: np.ndarray, yaw_rate_radps: np.ndarray) -> Labels:
    known = np.isfinite(steering_rad) | np.isfinite(yaw_rate_radps)
    return Labels(steering_rad, known, np.full(len(known), np.nan), yaw_rate_radps)
