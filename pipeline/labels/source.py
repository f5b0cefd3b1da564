"""Write a drive's labels from one of the sources, the files of ``pipeline/labels/sources``.

A source's file has MEASURED, whether it is measured motion, which a model must not get as input and
label at once; and ``read(raw, motion, car, look_ahead)``, which returns the labels of a drive, None
if it lacks the source.
"""

import importlib
from contextlib import nullcontext
from pathlib import Path
from typing import Any

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

# Cars do not slide sideways: vl stays below 0.4 m/s in KITTI. Above this limit, heading or GNSS
# velocity is wrong, and the label with it: 2011_09_26_drive_0093 has 14 m/s to the left and then 11
# m/s backwards.
SIDEWAYS_MPS = 1.0


def labels_drive(
    path: Path, ingest: Path, motion: Path | None = None, *, settings: Settings
) -> Summary:
    """Write data/labels/<drive>.h5; count frames: all, valid, in bends, sliding sideways, and
    interpolated.

    Frames that are measured backwards while the recorded speed goes ahead have no label: its sign
    is wrong.
    """
    with DriveReader(ingest, stage="ingest") as raw:
        drive, frame, time_s = raw.drive, raw.frame, raw.time_s
        car = Car(settings.wheelbase_m, settings.min_speed_mps)
        labels = read(settings.source, raw, motion, car)
        measured = load(settings.source).MEASURED
        if motion and not measured and not column(settings.source):
            labels = labels.without(backwards(labels, read("visual", raw, motion, car)))
        unknown = sideways = np.zeros(len(frame), bool)
        if not measured and "oxts" in raw:
            unknown = np.isnan(raw["speed_mps"])
            sideways = np.abs(raw["left_mps"]) > SIDEWAYS_MPS
    with DriveWriter(
        path, stage="labels", drive=drive, params={"labels": settings.model_dump()}
    ) as file:
        file.attrs["measured"] = int(measured)
        write(file, frame, time_s, labels, settings)
    counts = {
        "valid": labels.valid,
        "turning": labels.valid & (np.abs(labels.steering_rad) > TURNING_RAD),
    }
    counts |= {"sideways": sideways, "interpolated": unknown}
    return {"frames": len(frame)} | {name: int(mask.sum()) for name, mask in counts.items()}


def write(
    file: DriveWriter, frame: np.ndarray, time_s: np.ndarray, labels: Labels, settings: Settings
) -> None:
    """Write labels of the frames [F], unknown rates as 0, tan Θ / L, and with `ahead_m` the path
    ahead.
    """
    file.put("frame", np.asarray(frame, np.int32))
    file.put("time_s", time_s, "s")
    file.put("steering_rad", labels.steering_rad, "rad, left positive")
    file.put("valid", labels.valid.astype(np.uint8))
    file.put("speed_mps", np.nan_to_num(labels.speed_mps), "m/s")
    file.put("yaw_rate_radps", np.nan_to_num(labels.yaw_rate_radps), "rad/s, left positive")
    file.put(
        "curvature_1pm", np.tan(labels.steering_rad) / settings.wheelbase_m, "1/m, left positive"
    )
    if settings.ahead_m:
        curvature_1pm, valid = path_ahead(
            frame, time_s, labels, settings.ahead_m, settings.max_stand_s
        )
        file.put("ahead_1pm", curvature_1pm, "1/m, left positive")
        file.put("ahead_valid", valid.astype(np.uint8))


def read(
    source: str, raw: DriveReader, motion: Path | None, car: Car, *, look_ahead: bool = True
) -> Labels:
    """Return a drive's labels, valid from the car's minimum speed on.

    `raw`, `motion`: the drive's files of stages ingest and motion; `look_ahead`: as of
    :func:`measured_motion`. Raises InputError if the drive lacks the source.
    """
    labels = _read(source, raw, motion, car, look_ahead)
    if labels is None:
        fix = (
            "Set labels.source in params.yaml to a source that all drives have, for instance visual"
        )
        needed = (load(source).__doc__ or source).splitlines()[0].rstrip(".")
        raise InputError(f"drive has no labels.source: {source} ({needed})", raw.path, fix)
    return labels


def recorded(raw: DriveReader, car: Car) -> dict[str, Labels]:
    """Return the labels of each source that an ingest file has: those that were recorded, not
    measured.

    The yaw rate is a recorded one, NaN without; not that of a bicycle model.
    """
    found = {
        source: _read(source, raw, None, car, True)
        for source in SOURCES
        if not load(source).MEASURED
    }
    rates = recorded_motion(raw)
    yaw_rate_radps = np.full(len(raw.frame), np.nan) if rates is None else rates[1]
    return {
        kind: labels._replace(yaw_rate_radps=yaw_rate_radps)
        for kind, labels in found.items()
        if labels
    }


def _read(
    source: str, raw: DriveReader, motion: Path | None, car: Car, look_ahead: bool
) -> Labels | None:
    with DriveReader(motion, stage="motion") if motion else nullcontext() as file:
        labels: Labels | None = load(source).read(raw, file, car, look_ahead=look_ahead)
        return labels


def load(source: str) -> Any:
    """Return the module of a source's file."""
    return importlib.import_module(f"pipeline.labels.sources.{source}")


def column(source: str) -> str:
    """Return how a message names the recorded angle of a source; empty if it follows from yaw rate
    and speed.
    """
    return getattr(load(source), "COLUMN", "")
