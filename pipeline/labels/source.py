"""Make and write a drive's labels by one of the files of ``pipeline/labels/sources``.

Such a file has MEASURED, which is true for measured motion: a model must not get that as input and
label at once. Its ``read(raw, motion, car, look_ahead)`` returns the labels of a drive, or None if
the drive lacks the source. NEEDS and COLUMN, the name of a recorded angle, are texts for messages.
"""

import importlib
from contextlib import nullcontext
from pathlib import Path
from types import ModuleType

import numpy as np

from pipeline.base.errors import InputError
from pipeline.base.runner import Summary
from pipeline.base.store import DriveReader, DriveWriter
from pipeline.labels.agreement import backwards
from pipeline.labels.ahead import path_ahead
from pipeline.labels.by_row import recorded_motion
from pipeline.labels.label import TURNING_RAD, Car, Labels
from pipeline.labels.settings import SOURCES
from pipeline.labels.settings import Labels as Settings

# Largest sideways speed in m/s of a car: vl stays below 0.4 in KITTI. Above this limit, heading or
# GNSS velocity is wrong, and the label with it: 2011_09_26_drive_0093 has 14 m/s to the left and
# then 11 m/s backwards.
SIDEWAYS_MPS = 1.0


def labels_drive(
    path: Path, ingest: Path, motion: Path | None = None, *, settings: Settings
) -> Summary:
    """Write data/labels/<drive>.h5, and return counts of frames for the summary.

    Frames that are measured backwards while the recorded speed goes ahead have no label: its sign
    is wrong.
    """
    car = Car(settings.wheelbase_m, settings.min_speed_mps)
    measured = load_source(settings.source).MEASURED
    with DriveReader(ingest, stage="ingest") as raw:
        labels = make_labels(settings.source, raw, motion, car)
        if motion and not measured and not angle_column(settings.source):
            labels = labels.without(backwards(labels, make_labels("visual", raw, motion, car)))
        interpolated = np.zeros(len(raw.frame), bool)
        sideways = interpolated
        if not measured and "oxts" in raw:
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
    """Write labels of the frames [F], with `ahead_m` the path ahead, too; unknown rates are 0."""
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
    """Return a drive's labels, valid from the car's minimum speed on.

    `raw` and `motion` are the drive's files of stages ingest and motion; `look_ahead` is that of
    :func:`measured_motion`. Raises InputError if the drive lacks the source.
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
    """Return source → labels of all that an ingest file has, of what was recorded, not measured.

    The yaw rate is a recorded one, NaN without; not that of a bicycle model.
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
    """Return how a message names the recorded angle of a source, or an empty text.

    It is empty if the angle follows from yaw rate and speed.
    """
    return getattr(load_source(source), "COLUMN", "")
