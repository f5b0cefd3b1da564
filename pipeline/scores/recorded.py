"""Compare what drives recorded with what stage motion measured in their images."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from pipeline.base.store import DriveReader
from pipeline.base.summary import DOUBT
from pipeline.labels.label import Car, steering_labels
from pipeline.motion.motion_file import read_rates
from pipeline.scores import agreement
from pipeline.scores.agreement import Pair, SpeedPair

# Quantity → facts about its recorded values, and their ``line`` of text.
Facts = dict[str, dict[str, Any]]

# Least number of compared frames of a drive that is judged alone. Of 152 pieces of healthy rendered
# drives, 5 are doubted if they have 20 frames, and none if they have 30.
ALONE_FRAMES = 30


class Recorded(NamedTuple):
    """The quantities of a drive, in the F frames of its file of stage motion."""

    yaw_rate: Pair  # rad/s
    angle: Pair  # rad, of the front wheels
    speed: SpeedPair
    height_known: bool  # whether the height of the camera over the road is known
    one_clock: bool  # whether all images are of one file, so that a log has one offset

    @classmethod
    def read(cls, raw: DriveReader, motion: DriveReader, car: Car) -> "Recorded":
        """Read the files of stages ingest and motion. What the drive lacks is NaN."""
        rows = np.searchsorted(raw.frame, motion.frame)
        unknown = np.full(len(rows), np.nan)
        speed_mps = unknown
        yaw_rate_radps = unknown
        if "speed_mps" in raw:
            speed_mps = raw["speed_mps"][rows]
            yaw_rate_radps = raw["yaw_rate_radps"][rows]
        angle_rad = unknown
        if "steering_rad" in raw:
            has_angle = raw["has_steering"][rows] > 0
            angle_rad = np.where(has_angle, raw["steering_rad"][rows], np.nan)

        measured = read_rates(motion, smooth=True)
        labels = steering_labels(measured.yaw_rate_radps, measured.speed_mps, car)
        measured_rad = np.where(labels.valid, labels.steering_rad, np.nan)
        turns = agreement.is_turning(measured.yaw_rate_radps, measured.yaw_sigma_radps)
        speed_sigma_mps = np.abs(measured.speed_mps) * measured.speed_sigma
        return cls(
            yaw_rate=Pair(motion.time_s, yaw_rate_radps, measured.yaw_rate_radps, turns),
            angle=Pair(motion.time_s, angle_rad, measured_rad, turns),
            speed=SpeedPair(motion.time_s, speed_mps, measured.speed_mps, speed_sigma_mps),
            height_known=bool(motion.attrs["scaled"]),
            one_clock="recordings" not in raw.params,
        )


def compare_recorded(drives: Sequence[Recorded], name: str, *, advise: bool = True) -> Facts:
    """Return facts about the recorded values of all frames of `drives`.

    Quantities that no drive recorded are left out. `name` is that of the logs. With `advise`, lines
    have the offset that takes a log's lag away.
    """
    content: Facts = {}
    # Each of several files has an offset of its own.
    advise = advise and all(drive.one_clock for drive in drives)
    for quantity, unit in (("yaw_rate", "rad/s"), ("angle", "rad")):
        follow = agreement.fit_log([getattr(drive, quantity) for drive in drives])
        if follow:
            title = f"{quantity.replace('_', ' ')} of {name}"
            line = agreement.turns_line(title, unit, follow, advise=advise)
            content[quantity] = {**follow._asdict(), "line": line}

    speed = agreement.compare_speeds([drive.speed for drive in drives])
    if speed:
        height_known = all(drive.height_known for drive in drives)
        line = agreement.speed_line(f"speed of {name}", speed, height_known=height_known)
        content["speed"] = {**speed._asdict(), "line": line}
    return content


def compare_drives(drives: Mapping[str, Recorded], name: str, *, advise: bool) -> Facts:
    """Return ``QUANTITY of NAME`` → facts: of each drive with a doubt, then of all `drives`.

    A drive is judged alone by a quantity of which ALONE_FRAMES or more are compared. `name` is that
    of the group of drives, and `advise` that of :func:`compare_recorded`.
    """
    pooled = compare_recorded([*drives.values()], f"{name} ({len(drives)})", advise=advise)
    short_drives = dict.fromkeys(pooled, 0)
    content: Facts = {}
    for drive, recorded in drives.items():
        alone = compare_recorded([recorded], drive, advise=advise)
        for quantity in pooled:
            facts = alone.get(quantity)
            if facts is None or facts["frames"] < ALONE_FRAMES:
                short_drives[quantity] += 1
            elif facts["line"].startswith(DOUBT):
                content[f"{quantity} of {drive}"] = facts

    for quantity, facts in pooled.items():
        short = short_drives[quantity]
        if short:
            rule = f"drives with fewer than {ALONE_FRAMES} frames, which are not judged alone"
            facts["line"] += f"; {rule}: {short}"
        content[f"{quantity} of {name}"] = {**facts, "short_drives": short}
    return content
