"""Describe one drive's HDF5 file, whichever stage wrote it; errors and gaps as all commands print them."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import pairwise
from operator import itemgetter
from pathlib import Path
from typing import Any

from pipeline.base.errors import InputError
from pipeline.base.store import DriveReader

_HEADER = ("schema", "drive", "stage", "params")
_MAX_SPANS = 8
_FIX = "Make it again: dvc repro --force --single-item STAGE. Or fetch it: dvc pull"


@contextmanager
def read_errors(path: Path, fix: str = "Make it again: dvc repro. Or fetch it: dvc pull") -> Iterator[None]:
    """Raise InputError for whatever a library raises on a damaged file; errors of the system stay as they are.

    HDF5 and YAML raise many kinds, from KeyError to RecursionError.
    """
    try:
        yield
    except InputError:
        raise
    except Exception as error:
        if isinstance(error, OSError) and error.errno:
            raise
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise InputError(f"file is damaged ({reason})", path, fix) from error


@contextmanager
def open_drive(path: Path) -> Iterator[DriveReader]:
    """Open a drive's file of any stage. Raises InputError if it is damaged, also for errors within the block."""
    with read_errors(path, _FIX), DriveReader(path, stage=None) as file:
        yield file


def describe(path: Path) -> dict[str, Any]:
    """Return :func:`summary` and a table of the datasets, the largest first. Raises InputError."""
    content = {"kind": "drive file", "path": str(path), **summary(path)}
    with open_drive(path) as file:
        rows = [
            {
                "dataset": name,
                "shape": list(dataset.shape),
                "dtype": str(dataset.dtype),
                "unit": str(dataset.attrs.get("unit", "")),
                "bytes": dataset.id.get_storage_size(),
            }
            for name, dataset in ((name, file.dataset(name)) for name in file.names)
        ]
    return content | {"datasets": sorted(rows, key=itemgetter("bytes"), reverse=True)}


def summary(path: Path) -> dict[str, Any]:
    """Return stage, drive, bytes, frames, attributes and params of a drive's file. Raises InputError."""
    with open_drive(path) as file:
        frames, times = file.frame.tolist(), file.time_s
        attributes = [(name, value) for name, value in sorted(file.attrs.items()) if name not in _HEADER]
        return {
            "stage": str(file.attrs["stage"]),
            "drive": file.drive,
            "bytes": path.stat().st_size,
            "frames": len(frames),
            "first": frames[0] if frames else None,
            "last": frames[-1] if frames else None,
            "missing": spans(gaps(frames, frames[0], frames[-1])) if frames else "",
            "duration_s": float(times[-1] - times[0]) if frames else 0.0,
            "attributes": {name: value.tolist() if hasattr(value, "tolist") else value for name, value in attributes},
            "params": file.params,
        }


def gaps(frames: Sequence[int], first: int, last: int) -> list[tuple[int, int]]:
    """Return (first, last) of each run missing from ascending `frames` between `first` and `last`, both included."""
    edges = [first - 1, *frames, last + 1]
    return [(start + 1, stop - 1) for start, stop in pairwise(edges) if stop > start + 1]


def spans(runs: Sequence[tuple[int, int]]) -> str:
    """Return runs of frame numbers as text: 3, 7-9."""
    texts = [str(first) if first == last else f"{first}-{last}" for first, last in runs[:_MAX_SPANS]]
    return ", ".join([*texts, f"… ({len(runs)} in total)"] if len(runs) > _MAX_SPANS else texts)
