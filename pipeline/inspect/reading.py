"""Reading what may be anything: files of other tools, half-copied ones, flipped bits. All end in one line."""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from pipeline.base.errors import InputError

_MOST_BYTES = 64 << 20  # of a text file that is read whole; the largest that stages write have some 100 kB


@contextmanager
def damage_told(path: Path, hint: str = "Make or fetch it again: dvc repro, dvc pull") -> Iterator[None]:
    """Make one InputError of whatever is raised by libraries that read a damaged file.

    HDF5 raises a dozen kinds, from KeyError to MemoryError. What the system says (no permission, …) stays.
    """
    try:
        yield
    except InputError:
        raise
    except Exception as error:
        if isinstance(error, OSError) and error.errno:
            raise
        said = " ".join(str(error).split())[:200] or type(error).__name__
        raise InputError(f"{path} is damaged ({said}). {hint}") from error


def text(path: Path) -> str:
    """Return a text file's content. Raises InputError if it is large or not UTF-8."""
    if path.stat().st_size > _MOST_BYTES:
        raise InputError(f"{path} is damaged: {path.stat().st_size} bytes are too many for what it should hold")
    with damage_told(path):
        return path.read_text(encoding="utf-8")


def json_object(path: Path) -> dict[str, Any]:
    """Return the JSON object that a file holds. Raises InputError if it holds anything else."""
    content = text(path)
    with damage_told(path):  # RecursionError too
        value = json.loads(content)
    if not isinstance(value, dict):
        raise InputError(f"{path} is damaged: it holds {type(value).__name__}, not a JSON object")
    return value


def mapping(value: Any) -> dict[str, Any]:
    """Return `value` if it is a mapping, else an empty one: what stands in a file may be of another kind."""
    return value if isinstance(value, dict) else {}


def size_of(path: Path) -> int:
    """Return the bytes of a file, or of all files below a folder."""
    if not path.is_dir():
        return path.stat().st_size
    return sum(file.lstat().st_size for file in path.rglob("*") if not file.is_dir())
