"""Compare what drives recorded with what stage motion measured in their images."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from pipeline.base.store import DriveReader
from pipeline.labels.label import Car, steering_labels
from pipeline.motion.rates import read_rates
from pipeline.scores import agreement
from pipeline.scores.agreement import Pair


class Recorded(NamedTuple):
    """The quantities of a drive, in the F frames of its file of stage motion."""

    yaw_rate: Pair  # rad/s
    angle: Pair  # rad, of the front wheels
    speed: Pair  # m/s
    height_known: bool  # whether the height of the camera over the road is known

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
        return cls(
            yaw_rate=Pair(motion.time_s, yaw_rate_radps, measured.yaw_rate_radps, turns),
            angle=Pair(motion.time_s, angle_rad, measured_rad, turns),
            speed=Pair(motion.time_s, speed_mps, measured.speed_mps, turns),
            height_known=bool(motion.attrs["scaled"]),
        )


def compare_recorded(drives: Sequence[Recorded], name: str) -> dict[str, dict[str, Any]]:
    """Return quantity → facts about the recorded values of drives, and their ``line`` of text.

    Quantities that no drive recorded are left out. `name` is that of the logs.
    """
    content: dict[str, dict[str, Any]] = {}
    for quantity, unit in (("yaw_rate", "rad/s"), ("angle", "rad")):
        follow = agreement.fit_log([getattr(drive, quantity) for drive in drives])
        if follow:
            title = f"{quantity.replace('_', ' ')} of {name}"
            line = agreement.turns_line(title, unit, follow)
            content[quantity] = {**follow._asdict(), "line": line}

    speed = agreement.compare_speeds([drive.speed for drive in drives])
    if speed:
        height_known = all(drive.height_known for drive in drives)
        line = agreement.speed_line(f"speed of {name}", speed, height_known=height_known)
        content["speed"] = {**speed._asdict(), "line": line}
    return content
