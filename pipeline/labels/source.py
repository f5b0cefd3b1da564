"""Make and write a drive's labels from one of the files in ``pipeline/labels/sources``.

The function ``read(raw, motion, car, look_ahead)`` of such a file returns the labels of a drive, or
None if the drive lacks the source. Its constants are:

- MEASURED is true if the labels follow from motion that stage motion measures. A model must not get
  this motion as an input if it is the label, too.
- NEEDS describes the source in the message about a drive that lacks it.
- COLUMN is the name of the recorded angle in messages. A source has no COLUMN if its angles follow
  from yaw rate and speed.
"""

import importlib
from contextlib import nullcontext
from pathlib import Path
from types import ModuleType

import numpy as np

from pipeline.base.errors import InputError
from pipeline.base.runner import Summary
from pipeline.base.store import DriveReader, DriveWriter
from pipeline.labels.ahead import path_ahead
from pipeline.labels.by_row import recorded_motion
from pipeline.labels.label import TURNING_RAD, Car, Labels
from pipeline.labels.settings import SOURCES
from pipeline.labels.settings import Labels as Settings

# Largest plausible sideways speed in m/s of a car. In KITTI, the sideways speed vl stays below 0.4.
# Above this limit, the recorded heading or GNSS velocity is wrong, and so is the label. Such frames
# are counted. For instance, 2011_09_26_drive_0093 has 14 m/s to the left and then 11 m/s backwards.
SIDEWAYS_MPS = 1.0


def labels_drive(
    path: Path, ingest: Path, motion: Path | None = None, *, settings: Settings
) -> Summary:
    """Write data/labels/<drive>.h5, and return counts of frames for the summary."""
    car = Car(settings.wheelbase_m, settings.min_speed_mps)
    measured = load_source(settings.source).MEASURED
    with DriveReader(ingest, stage="ingest") as raw:
        labels = make_labels(settings.source, raw, motion, car)
        interpolated = np.zeros(len(raw.frame), bool)
        sideways = np.zeros(len(raw.frame), bool)
        if not measured and "oxts" in raw:
            # Stage ingest leaves the speed unknown where KITTI interpolated the packet.
            interpolated = np.isnan(raw["speed_mps"])
            sideways = np.abs(raw["left_mps"]) > SIDEWAYS_MPS

    params = {"labels": settings.model_dump()}
    with DriveWriter(path, stage="labels", drive=raw.drive, params=params) as file:
        file.attrs["measured"] = int(measured)
        write_labels(file, raw.frame, raw.time_s, labels, settings)
    turning = labels.valid & (np.abs(labels.steering_rad) > TURNING_RAD)
    return {
        "frames": len(raw.frame),
        "valid": int(labels.valid.sum()),
        "turning": int(turning.sum()),
        "sideways": int(sideways.sum()),
        "interpolated": int(interpolated.sum()),
    }


def write_labels(
    file: DriveWriter, frame: np.ndarray, time_s: np.ndarray, labels: Labels, settings: Settings
) -> None:
    """Write the labels of frames [F], and their path ahead if the settings have `ahead_m`.

    Unknown speeds and yaw rates are written as 0.
    """
    file.put("frame", np.asarray(frame, np.int32))
    file.put("time_s", time_s, "s")
    file.put("steering_rad", labels.steering_rad, "rad, left positive")
    file.put("valid", labels.valid.astype(np.uint8))
    file.put("speed_mps", np.nan_to_num(labels.speed_mps), "m/s")
    file.put("yaw_rate_radps", np.nan_to_num(labels.yaw_rate_radps), "rad/s, left positive")
    curvature_1pm = np.tan(labels.steering_rad) / settings.wheelbase_m
    file.put("curvature_1pm", curvature_1pm, "1/m, left positive")
    if settings.ahead_m:
        ahead_1pm, valid = path_ahead(frame, time_s, labels, settings.ahead_m, settings.max_stand_s)
        file.put("ahead_1pm", ahead_1pm, "1/m, left positive")
        file.put("ahead_valid", valid.astype(np.uint8))


def make_labels(
    source: str, raw: DriveReader, motion: Path | None, car: Car, *, look_ahead: bool = True
) -> Labels:
    """Return a drive's labels. They are valid where the car has at least its minimum speed.

    `raw` and `motion` are the drive's files of stages ingest and motion. With `look_ahead`,
    measured rates are means over neighbouring frames, later ones included. Without it, they are the
    causal rates that models get. Raises InputError if the drive lacks the source.
    """
    labels = _labels_or_none(source, raw, motion, car, look_ahead)
    if labels is None:
        needed = getattr(load_source(source), "NEEDS", source)
        problem = f"drive has no labels.source: {source} ({needed})"
        fix = "Set labels.source in params.yaml to a source that all drives have, "
        fix += "for instance visual"
        raise InputError(problem, raw.path, fix)
    return labels


def recorded_labels(raw: DriveReader, car: Car) -> dict[str, Labels]:
    """Return source → labels, for each recorded source that an ingest file has.

    Measured motion is left out. The yaw rate of all labels is the recorded one, and NaN if the
    drive has none. It is never computed from a recorded angle.
    """
    rates = recorded_motion(raw)
    yaw_rate_radps = np.full(len(raw.frame), np.nan)
    if rates is not None:
        yaw_rate_radps = rates.yaw_rate_radps
    recorded = {}
    for source in SOURCES:
        if not load_source(source).MEASURED:
            labels = _labels_or_none(source, raw, None, car, look_ahead=True)
            if labels:
                recorded[source] = labels._replace(yaw_rate_radps=yaw_rate_radps)
    return recorded


def _labels_or_none(
    source: str, raw: DriveReader, motion: Path | None, car: Car, look_ahead: bool
) -> Labels | None:
    with DriveReader(motion, stage="motion") if motion else nullcontext() as file:
        labels: Labels | None = load_source(source).read(raw, file, car, look_ahead=look_ahead)
        return labels


def load_source(source: str) -> ModuleType:
    """Return the module of a source's file."""
    return importlib.import_module(f"pipeline.labels.sources.{source}")


def angle_column(source: str) -> str:
    """Return the name of a source's recorded angle for messages.

    It is empty if the source has none, since its angles follow from yaw rate and speed.
    """
    return getattr(load_source(source), "COLUMN", "")
