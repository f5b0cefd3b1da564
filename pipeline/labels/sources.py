"""Write a drive's labels, from oxts, from measured motion (visual), or from recorded steering angles (wheel)."""

from pathlib import Path

import numpy as np

from pipeline.base.errors import InputError
from pipeline.base.runner import Summary
from pipeline.base.store import DriveReader, DriveWriter
from pipeline.kitti.oxts import VF, VL, WU, interpolated, make_rows
from pipeline.labels.ahead import path_ahead
from pipeline.labels.label import TURNING_RAD, Car, Labels, steering_labels
from pipeline.labels.rates import measured_rates, stands
from pipeline.settings.labels import Labels as Settings

# Datasets of an ingest file, and how a message names them.
RECORDED = {"oxts": ("oxts", "oxts"), "wheel": ("steering_rad", "recorded steering angles (steering.csv)")}
# Cars do not slide sideways: vl stays below 0.4 m/s in KITTI. Above this limit, heading or GNSS velocity is wrong, and
# the label with it: 2011_09_26_drive_0093 has 14 m/s to the left and then 11 m/s backwards.
SIDEWAYS_MPS = 1.0


def labels_drive(path: Path, ingest: Path, motion: Path | None = None, *, settings: Settings) -> Summary:
    """Write data/labels/<drive>.h5; count frames: all, valid, in bends, sliding sideways, and interpolated."""
    with DriveReader(ingest, stage="ingest") as raw:
        drive, frame, time_s = raw.drive, raw.frame, raw.time_s
        labels = read(settings.source, raw, motion, Car(settings.wheelbase_m, settings.min_speed_mps))
        packets = raw["oxts"] if settings.source != "visual" and "oxts" in raw else make_rows(len(frame))
    with DriveWriter(path, stage="labels", drive=drive, params={"labels": settings.model_dump()}) as file:
        write(file, frame, time_s, labels, settings)
    guessed = interpolated(packets)
    counts = {"valid": labels.valid, "turning": labels.valid & (np.abs(labels.steering_rad) > TURNING_RAD)}
    counts |= {"sideways": (np.abs(packets[:, VL]) > SIDEWAYS_MPS) & ~guessed, "interpolated": guessed}
    return {"frames": len(frame)} | {name: int(mask.sum()) for name, mask in counts.items()}


def write(file: DriveWriter, frame: np.ndarray, time_s: np.ndarray, labels: Labels, settings: Settings) -> None:
    """Write labels of the frames [F], unknown rates as 0, tan Θ / L, and with `ahead_m` the path ahead."""
    file.put("frame", np.asarray(frame, np.int32))
    file.put("time_s", time_s, "s")
    file.put("steering_rad", labels.steering_rad, "rad, left positive")
    file.put("valid", labels.valid.astype(np.uint8))
    file.put("speed_mps", np.nan_to_num(labels.speed_mps), "m/s")
    file.put("yaw_rate_radps", np.nan_to_num(labels.yaw_rate_radps), "rad/s, left positive")
    file.put("curvature_1pm", np.tan(labels.steering_rad) / settings.wheelbase_m, "1/m, left positive")
    if settings.ahead_m:
        curvature_1pm, valid = path_ahead(frame, time_s, labels, settings.ahead_m, settings.max_stand_s)
        file.put("ahead_1pm", curvature_1pm, "1/m, left positive")
        file.put("ahead_valid", valid.astype(np.uint8))


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
    labels = steering_labels(yaw_rate_radps, speed_mps, car)
    if source == "wheel":
        valid = labels.valid | ~np.isfinite(speed_mps) & ~still
        return labels._replace(steering_rad=raw["steering_rad"], valid=valid & raw["has_steering"].astype(bool))
    return labels
