"""Labels of a drive from each source: oxts, measured motion (visual, lidar), or recorded steering angles (wheel)."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.base.errors import InputError
from pipeline.base.store import DriveReader
from pipeline.kitti.oxts import VF, WU
from pipeline.labels.label import Labels, steering_labels
from pipeline.motion.motion_file import open_motion

_CHOOSE_ANOTHER = "Set labels.source in params.yaml to a source that all drives have, for instance visual"


def recorded(raw: DriveReader) -> list[str]:
    """Return the sources in an ingest file: those that were recorded, not measured."""
    return [source for source, name in {"oxts": "oxts", "wheel": "steering_rad"}.items() if name in raw]


def read(source: str, raw: DriveReader, motions: Mapping[str, Path], rule: Mapping[str, Any]) -> Labels:
    """Return a drive's labels.

    Every recorded angle is valid, even at unknown speed. With source wheel, speed and yaw rate are
    read from oxts or, in a drive without oxts, from measured motion.

    Args:
        source: a value of ``labels.source``.
        raw: the drive's ingest file.
        motions: kind of measured motion → its folder.
        rule: keyword arguments of :func:`pipeline.labels.label.steering_labels`.

    Raises InputError if the drive lacks the source.
    """
    if source in ("oxts", "wheel") and source not in recorded(raw):
        missing = {"oxts": "no oxts", "wheel": "no recorded steering angles (steering.csv)"}[source]
        raise InputError(f"drive has {missing}, which labels.source: {source} needs", raw.path, _CHOOSE_ANOTHER)
    rates = source
    if source == "wheel":
        rates = next((kind for kind in ("oxts", "visual", "lidar") if kind in (*motions, *recorded(raw))), "")
    speed_mps, yaw_rate_radps = _rates(rates, raw, motions)
    known = np.isfinite(speed_mps)
    steering_rad, valid = steering_labels(yaw_rate_radps, speed_mps, **rule)
    if source == "wheel":
        steering_rad, valid = raw["steering_rad"], (valid | ~known) & raw["has_steering"].astype(bool)
    else:
        steering_rad, valid = np.where(known, steering_rad, 0.0), valid & known
    return Labels(steering_rad, valid, speed_mps, yaw_rate_radps)


def _rates(source: str, raw: DriveReader, motions: Mapping[str, Path]) -> tuple[np.ndarray, np.ndarray]:
    """Return speed and yaw rate, float64 [F]; NaN where they are not measured."""
    if source == "oxts":
        return raw["oxts"][:, VF], raw["oxts"][:, WU]
    rates = np.full((2, len(raw.frame)), np.nan)
    if source:
        if source not in motions:
            raise InputError(f"motion.kinds has only {', '.join(motions)}", f"labels.source: {source}")
        with open_motion(motions[source], raw.drive, raw.frame) as motion:
            rows = np.searchsorted(raw.frame, motion.frame)
            both = np.stack([motion["speed_mps"], motion["yaw_rate_radps"]]).astype(np.float64)
            rates[:, rows] = np.where(motion["valid"].astype(bool), both, np.nan)
    return rates[0], rates[1]
