"""Labels of a drive from each source: oxts, measured motion (visual), or recorded steering angles (wheel)."""

from pathlib import Path

import numpy as np

from pipeline.base.errors import InputError
from pipeline.base.store import DriveReader
from pipeline.kitti.oxts import VF, WU, interpolated
from pipeline.labels.label import Car, Labels, steering_labels
from pipeline.labels.rates import measured_rates, stands

# Datasets of an ingest file, and how a message names them.
RECORDED = {"oxts": ("oxts", "oxts"), "wheel": ("steering_rad", "recorded steering angles (steering.csv)")}


def recorded(raw: DriveReader) -> list[str]:
    """Return the sources in an ingest file: those that were recorded, not measured."""
    return [source for source, (dataset, _) in RECORDED.items() if dataset in raw]


def read(source: str, raw: DriveReader, motion: Path | None, car: Car, *, look_ahead: bool = True) -> Labels:
    """Return a drive's labels, valid from the car's minimum speed on.

    A recorded angle is also valid at unknown speed, unless the motion is unknown because nothing moves. With source
    wheel, speed and yaw rate are read from oxts or, in a drive without oxts, from measured motion. An interpolated
    packet is no measurement: speed and yaw rate are unknown.

    `raw`, `motion`: the drive's files of stages ingest and motion. With `look_ahead`, measured rates are means over
    neighbouring frames, later ones included, which no model may get as inputs; else the causal rates that models get.
    Raises InputError if the drive lacks the source.
    """
    if source != "visual" and source not in recorded(raw):
        fix = "Set labels.source in params.yaml to a source that all drives have, for instance visual"
        raise InputError(f"drive has no {RECORDED[source][1]}, which labels.source: {source} needs", raw.path, fix)
    speed_mps, yaw_rate_radps = np.full((2, len(raw.frame)), np.nan)
    still = np.zeros(len(raw.frame), bool)
    if motion:
        with DriveReader(motion, stage="motion") as file:
            rows = np.searchsorted(raw.frame, file.frame)
            yaw_rate_radps[rows], speed_mps[rows], *_ = measured_rates(file, look_ahead=look_ahead)
            still[rows] = stands(file)
    if source != "visual" and "oxts" in raw:
        packets = raw["oxts"]
        speed_mps, yaw_rate_radps = np.where(interpolated(packets), np.nan, packets[:, [VF, WU]].T)
    steering_rad, valid = steering_labels(yaw_rate_radps, speed_mps, car)
    if source == "wheel":
        valid |= ~np.isfinite(speed_mps) & ~still
        steering_rad, valid = raw["steering_rad"], valid & raw["has_steering"].astype(bool)
    return Labels(steering_rad, valid, speed_mps, yaw_rate_radps)
