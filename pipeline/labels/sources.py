"""Labels of a drive from each source: oxts, measured motion (visual), or recorded steering angles (wheel)."""

from pathlib import Path

import numpy as np

from pipeline.base.errors import InputError
from pipeline.base.store import DriveReader
from pipeline.kitti.oxts import VF, WU
from pipeline.labels.label import Car, Labels, steering_labels
from pipeline.labels.means import means
from pipeline.motion.step import PROBLEMS, STANDSTILL

_CHOOSE_ANOTHER = "Set labels.source in params.yaml to a source that all drives have, for instance visual"


def recorded(raw: DriveReader) -> list[str]:
    """Return the sources in an ingest file: those that were recorded, not measured."""
    return [source for source, name in {"oxts": "oxts", "wheel": "steering_rad"}.items() if name in raw]


def read(source: str, raw: DriveReader, motion: Path | None, car: Car, *, look_ahead: bool = True) -> Labels:
    """Return a drive's labels, valid from the car's minimum speed on.

    A recorded angle is also valid at unknown speed, unless the motion is unknown because nothing moves. With source
    wheel, speed and yaw rate are read from oxts or, in a drive without oxts, from measured motion.

    Args:
        source: a value of ``labels.source``.
        raw: the drive's ingest file.
        motion: the drive's file of measured motion; None: without.
        car: of the steering angle.
        look_ahead: measured rates are means over neighbouring frames, later ones included, which a target may know.
            False: the causal rates that models get.

    Raises InputError if the drive lacks the source.
    """
    if source in ("oxts", "wheel") and source not in recorded(raw):
        missing = {"oxts": "no oxts", "wheel": "no recorded steering angles (steering.csv)"}[source]
        raise InputError(f"drive has {missing}, which labels.source: {source} needs", raw.path, _CHOOSE_ANOTHER)
    speed_mps, yaw_rate_radps = np.full((2, len(raw.frame)), np.nan)
    if source != "visual" and "oxts" in raw:
        speed_mps, yaw_rate_radps = raw["oxts"][:, VF], raw["oxts"][:, WU]
    elif motion:
        speed_mps, yaw_rate_radps = _measured(raw, motion, look_ahead)
    known = np.isfinite(speed_mps)
    steering_rad, valid = steering_labels(yaw_rate_radps, speed_mps, **vars(car))
    if source == "wheel":
        unknown = ~known & ~_stands(raw, motion)
        steering_rad, valid = raw["steering_rad"], (valid | unknown) & raw["has_steering"].astype(bool)
    return Labels(steering_rad, valid, speed_mps, yaw_rate_radps)


def _stands(raw: DriveReader, motion: Path | None) -> np.ndarray:
    """Return bool [F]: the motion of a frame is not measured because nothing moves."""
    stands = np.zeros(len(raw.frame), bool)
    if motion:
        with DriveReader(motion, stage="motion") as file:
            stands[np.searchsorted(raw.frame, file.frame)] = np.isin(
                file["problem"], [PROBLEMS.index(text) for text in STANDSTILL]
            )
    return stands


def _measured(raw: DriveReader, path: Path, look_ahead: bool) -> np.ndarray:
    """Return speed and yaw rate, float64 [2,F]; NaN where they are not measured."""
    rates = np.full((2, len(raw.frame)), np.nan)
    with DriveReader(path, stage="motion") as motion:
        valid = motion["valid"].astype(bool)
        rows = np.searchsorted(raw.frame, motion.frame[valid])
        if look_ahead:
            names = "yaw_rate_radps", "speed_mps", "road_height_m"
            yaw_rate_radps, speed_mps, road_height_m = (motion[name][valid].astype(np.float64) for name in names)
            smooth = means(motion.time_s[valid], yaw_rate_radps, speed_mps, road_height_m > 0)
            rates[:, rows] = smooth.speed_mps, smooth.yaw_rate_radps
        else:
            rates[:, rows] = motion["filtered_mps"][valid], motion["yaw_rate_radps"][valid]
    return rates
