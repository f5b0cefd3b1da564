"""What a drive's HDF5 file holds, whichever stage wrote it."""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.base.errors import InputError
from pipeline.base.store import DriveReader
from pipeline.inspect.reading import damage_told, mapping

STAGES = ("ingest", "labels", "perception", "motion", "clouds", "graphs")
"""That write a file per drive."""
_HEADER = ("schema", "drive", "stage", "params")
_MOST_FRAMES = 10_000_000  # of a drive: eleven days at 10 Hz; a flipped bit makes more
_MOST_ROW_BYTES = 1 << 30


@contextmanager
def opened(path: Path) -> Iterator[DriveReader]:
    """Open the file of whichever stage wrote it. Raises InputError, one line, whatever is wrong with it, to the end.

    The block reads: what libraries raise in it is told as damage of the file.
    """
    with (
        damage_told(path, hint="Make it again: dvc repro --force --single-item its stage, or dvc pull"),
        _reader(path) as file,
    ):
        if not same_file(file, path):
            raise InputError(f"{path} is damaged: its datasets are links into another file")
        yield file


def same_file(file: DriveReader, path: Path) -> bool:
    """Say whether the datasets lie in the file itself."""
    return bool(Path(file.dataset("frame").file.filename) == path)


def _reader(path: Path) -> DriveReader:
    # Its folder mostly says whose it is, and the error of that stage's reader is the one worth reading.
    stages = sorted(STAGES, key=lambda stage: stage not in path.absolute().parts[:-1])
    errors = []
    for stage in stages:
        try:
            return DriveReader(path, stage=stage)
        except InputError as error:
            errors.append(error)
    raise errors[0]


def describe(path: Path) -> dict[str, Any]:
    """Return what a drive's file holds: JSON-able. Raises InputError, one line, if it is damaged or not a drive's."""
    told = summary(path)
    with opened(path) as file:
        return {"kind": "drive file", "path": str(path), **told, "made_of": [told["drive"]], "datasets": datasets(file)}


def summary(path: Path) -> dict[str, Any]:
    """Return stage, drive, attributes, settings, bytes and frames of a drive's file. Raises as :func:`describe`."""
    with opened(path) as file:
        return {
            "stage": str(file.attrs["stage"]),
            "drive": file.drive,
            "bytes": path.stat().st_size,
            "frames": frames(file),
            "settings": mapping(json.loads(str(file.attrs["params"]))),
            "attributes": {name: _plain(value) for name, value in sorted(file.attrs.items()) if name not in _HEADER},
        }


def frames(file: DriveReader) -> dict[str, Any]:
    """Return how many frames a drive's file has, from which to which number, and where numbers are missing."""
    numbers, times = vector(file, "frame"), vector(file, "time_s")
    if len(numbers) != len(times) or (np.diff(numbers) <= 0).any() or not np.isfinite(times).all():
        raise InputError(f"{file.path} is damaged: frame numbers and times do not belong together")
    result: dict[str, Any] = {"count": len(numbers), "gaps": gaps(numbers)}
    if len(numbers):
        result |= {"first": int(numbers[0]), "last": int(numbers[-1]), "duration_s": float(times[-1] - times[0])}
    return result


def gaps(numbers: np.ndarray) -> list[list[int]]:
    """Return [first, last] of each run of numbers that is missing between ascending `numbers` [F]."""
    steps = np.flatnonzero(np.diff(numbers) > 1)
    return [[int(numbers[step]) + 1, int(numbers[step + 1]) - 1] for step in steps]


def vector(file: DriveReader, name: str) -> np.ndarray:
    """Return a dataset of one number per frame. Raises InputError if it is of another shape."""
    shape = file.shape(name)
    if len(shape) != 1 or shape[0] > _MOST_FRAMES or file.dataset(name).dtype.kind not in "iuf":
        raise InputError(f"{file.path} is damaged: dataset {name!r} has shape {shape}")
    return file[name]


def row(file: DriveReader, name: str, index: int) -> np.ndarray:
    """Return what belongs to one frame. Raises InputError if it is absurdly large."""
    dataset = file.dataset(name)
    if int(np.prod(dataset.shape[1:], dtype=np.float64)) * dataset.dtype.itemsize > _MOST_ROW_BYTES:
        raise InputError(f"{file.path} is damaged: dataset {name!r} has shape {dataset.shape}")
    return np.asarray(file.row(name, index))


def ragged(file: DriveReader, name: str, pointers: str, index: int) -> np.ndarray:
    """Return the rows of one frame of ragged data. Raises InputError if its pointers lead elsewhere."""
    start, stop = (int(at) for at in file.rows(pointers, index, index + 2))
    if not 0 <= start <= stop <= file.shape(name)[0]:
        raise InputError(f"{file.path} is damaged: {pointers} of row {index} goes from {start} to {stop}")
    return file.rows(name, start, stop)


def datasets(file: DriveReader) -> list[dict[str, Any]]:
    """Return name, shape, dtype, unit, bytes on disk and share of the file of each dataset, the largest first."""
    group, total, result = file.dataset("frame").file, file.path.stat().st_size, []
    for name in group:
        link = group.get(name, getlink=True)
        if type(link).__name__ != "HardLink":  # into other files: nothing of ours
            raise InputError(f"{file.path} is damaged: {name!r} is a link, where a dataset is expected")
        dataset = group[name]
        if not hasattr(dataset, "dtype"):
            raise InputError(f"{file.path} is damaged: {name!r} is a group, where a dataset is expected")
        stored = dataset.id.get_storage_size()
        result.append(
            {
                "name": name,
                "shape": list(dataset.shape),
                "dtype": str(dataset.dtype),
                "unit": str(dataset.attrs.get("unit", "")),
                "bytes": stored,
                "share": stored / total,
            }
        )
    return sorted(result, key=lambda one: -one["bytes"])


def _plain(value: Any) -> Any:
    return value.item() if isinstance(value, np.generic) else value.tolist() if isinstance(value, np.ndarray) else value
