"""Helpers shared by the commands: read errors, sizes, and gaps between frame numbers."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path

from pipeline.base.errors import InputError

_MAX_SPANS = 8


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


def size_of(path: Path) -> int:
    """Return the bytes of a file, or of all files below a folder."""
    if not path.is_dir():
        return path.stat().st_size
    return sum(file.lstat().st_size for file in path.rglob("*") if not file.is_dir())


def gaps(frames: Sequence[int], first: int, last: int) -> list[tuple[int, int]]:
    """Return (first, last) of each run missing from ascending `frames` between `first` and `last`, both included."""
    edges = [first - 1, *frames, last + 1]
    return [(start + 1, stop - 1) for start, stop in pairwise(edges) if stop > start + 1]


def spans(runs: Sequence[tuple[int, int]]) -> str:
    """Return runs of frame numbers as text: 3, 7-9."""
    texts = [str(first) if first == last else f"{first}-{last}" for first, last in runs[:_MAX_SPANS]]
    return ", ".join([*texts, f"… ({len(runs)} in total)"] if len(runs) > _MAX_SPANS else texts)
