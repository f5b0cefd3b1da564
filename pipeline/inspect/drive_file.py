"""Describe one drive's HDF5 file, whichever stage wrote it."""

from collections.abc import Iterator
from contextlib import contextmanager
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.base.errors import InputError
from pipeline.base.store import DriveReader
from pipeline.inspect.reading import gaps, read_errors, spans

STAGES = ("ingest", "labels", "perception", "motion", "clouds", "graphs")
"""Stages that write one file per drive."""
_HEADER = ("schema", "drive", "stage", "params")
_FIX = "Make it again: dvc repro --force --single-item STAGE. Or fetch it: dvc pull"


@contextmanager
def open_drive(path: Path) -> Iterator[DriveReader]:
    """Open a drive's file of any stage. Raises InputError if it is damaged, also for errors within the block."""
    with read_errors(path, _FIX), _reader(path) as file:
        yield file


def _reader(path: Path) -> DriveReader:
    # The folder usually names the stage: then its error message is the relevant one.
    stages = sorted(STAGES, key=lambda stage: stage not in path.absolute().parts[:-1])
    errors = []
    for stage in stages:
        try:
            return DriveReader(path, stage=stage)
        except InputError as error:
            errors.append(error)
    raise errors[0]


def describe(path: Path) -> dict[str, Any]:
    """Return :func:`summary` and a table of the datasets, the largest first. Raises InputError."""
    content = {"kind": "drive file", "path": str(path), **summary(path)}
    with open_drive(path) as file:
        rows = [_dataset_row(file, name) for name in file.names]
    return content | {"datasets": sorted(rows, key=itemgetter("bytes"), reverse=True)}


def summary(path: Path) -> dict[str, Any]:
    """Return stage, drive, bytes, frames, attributes and params of a drive's file. Raises InputError."""
    with open_drive(path) as file:
        frames, times = file.frame.tolist(), file.time_s
        return {
            "stage": str(file.attrs["stage"]),
            "drive": file.drive,
            "bytes": path.stat().st_size,
            "frames": len(frames),
            "first": frames[0] if frames else None,
            "last": frames[-1] if frames else None,
            "missing": spans(gaps(frames, frames[0], frames[-1])) if frames else "",
            "duration_s": float(times[-1] - times[0]) if frames else 0.0,
            "attributes": {name: _plain(value) for name, value in sorted(file.attrs.items()) if name not in _HEADER},
            "params": file.params,
        }


def _dataset_row(file: DriveReader, name: str) -> dict[str, Any]:
    dataset = file.dataset(name)
    return {
        "dataset": name,
        "shape": list(dataset.shape),
        "dtype": str(dataset.dtype),
        "unit": str(dataset.attrs.get("unit", "")),
        "bytes": dataset.id.get_storage_size(),
    }


def _plain(value: Any) -> Any:
    return value.tolist() if isinstance(value, np.generic | np.ndarray) else value
