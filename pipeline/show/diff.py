"""Compare two artefacts file by file: HDF5 by dataset and frame, JSON and checkpoints by key, others by byte.

Each file is read as columns: name → frame number → value, or function that reads the value.
"""

import filecmp
import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.base.errors import InputError
from pipeline.base.store import PER_DRIVE, DriveReader

Column = Mapping[int, Any]
_NO_FRAME = -1
_MAX_TEXT = 60  # characters of a value in a message


@dataclass(frozen=True)
class Difference:
    """One dataset, column or key in which two files differ."""

    file: str
    key: str
    """Empty for the file itself."""
    problem: str
    frames: int = 0
    """How many frames differ."""
    first_frame: int | None = None
    largest: float = 0.0
    """Largest absolute difference of two numbers."""

    def __str__(self) -> str:
        texts = [self.problem]
        if self.frames:
            texts.append(f"frames: {self.frames}, first {self.first_frame}")
        if self.largest:
            texts.append(f"largest difference {self.largest:.6g}")
        return ": ".join(filter(None, [self.file, self.key, ", ".join(texts)]))


def pairs(a: Path, b: Path) -> list[tuple[str, Path, Path]]:
    """Return (name, file of A, file of B) for two files, or for all files of two folders by relative path.

    Hidden files and folders are left out. Raises InputError if a path is missing, or if their kinds differ.
    """
    fix = "Pass two files of one kind, or two folders"
    for path in (a, b):
        if not (path.is_file() or path.is_dir()):
            raise InputError("no such file or folder", path, fix)
    if a.is_dir() != b.is_dir() or (a.is_file() and a.suffix != b.suffix):
        raise InputError(f"cannot be compared with {b}, which is of another kind", a, fix)
    if a.is_file():
        return [(a.name, a, b)]
    names = sorted({path.relative_to(top) for top in (a, b) for path in top.rglob("*") if path.is_file()})
    visible = [name for name in names if not any(part.startswith(".") for part in name.parts)]
    return [(str(name), a / name, b / name) for name in visible]


def compare(name: str, a: Path, b: Path, tolerance: float) -> Iterator[Difference]:
    """Yield the differences of two files; none if their bytes are equal. Raises InputError if a file is damaged.

    Args:
        tolerance: numbers that differ by at most this are equal.
    """
    if not (a.is_file() and b.is_file()):
        yield Difference(name, "", f"only in {'A' if a.is_file() else 'B'}")
    elif filecmp.cmp(a, b, shallow=False):
        return
    elif a.suffix not in (".h5", ".json", ".pt"):
        yield Difference(name, "", f"{a.stat().st_size} and {b.stat().st_size} bytes, not the same")
    else:
        with _columns(a) as columns_a, _columns(b) as columns_b:
            for key in dict.fromkeys([*columns_a, *columns_b]):
                if key in columns_a and key in columns_b:
                    yield from _compare_column(name, key, columns_a[key], columns_b[key], tolerance)
                else:
                    yield Difference(name, key, f"only in {'A' if key in columns_a else 'B'}")


def _compare_column(name: str, key: str, a: Column, b: Column, tolerance: float) -> Iterator[Difference]:
    unmatched = {"A": a.keys() - b.keys(), "B": b.keys() - a.keys()}
    texts = [
        f"{len(numbers)} frames only in {file}, first {min(numbers)}" for file, numbers in unmatched.items() if numbers
    ]
    frames: list[int] = []
    largest = 0.0
    for frame in (frame for frame in a if frame in b):
        value_a, value_b = (column[frame]() if callable(column[frame]) else column[frame] for column in (a, b))
        distances = _distances(value_a, value_b)
        if (distances > tolerance).any():
            texts += [] if frames else [_text(value_a, value_b)]
            frames.append(frame)
            largest = max(largest, float(distances[np.isfinite(distances)].max(initial=0.0)))
    if texts:
        numbers = [frame for frame in frames if frame != _NO_FRAME]
        yield Difference(name, key, ", ".join(texts), len(numbers), min(numbers, default=None), largest)


def _distances(value_a: Any, value_b: Any) -> np.ndarray:
    """Return absolute differences; infinity where values differ that are not numbers of one dtype and shape.

    NaN equals NaN.
    """
    if _form(value_a) != _form(value_b):
        return np.array([np.inf])
    a, b = np.asarray(value_a), np.asarray(value_b)
    if a.dtype.kind not in "iuf":
        return np.where(a == b, 0.0, np.inf)
    with np.errstate(invalid="ignore"):  # infinity minus infinity
        distances = np.nan_to_num(np.abs(a.astype(np.float64) - b.astype(np.float64)), nan=np.inf)
    smallest = np.finfo(np.float64).tiny  # of two int64 that are one float64
    return np.where((a == b) | ((a != a) & (b != b)), 0.0, np.maximum(distances, smallest))  # NaN is not itself


def _form(value: Any) -> str:
    """Return dtype and shape of an array; of another value its type, empty for numbers."""
    if isinstance(value, np.ndarray | np.generic):
        return f"{value.dtype} {value.shape}"
    return "" if isinstance(value, int | float) and not isinstance(value, bool) else type(value).__name__


def _text(a: Any, b: Any) -> str:
    if isinstance(a, np.ndarray | np.generic) and _form(a) != _form(b):
        return f"{_form(a)} and {_form(b)}"
    return "values differ" if np.ndim(a) else f"{a!s:.{_MAX_TEXT}} and {b!s:.{_MAX_TEXT}}"


@contextmanager
def _columns(path: Path) -> Iterator[Mapping[str, Column]]:
    if path.suffix == ".h5":
        with open_drive(path) as file:
            yield _drive_columns(file)
    else:
        from pipeline.train import checkpoint

        with damage_as_input_error(path):
            content = json.loads(path.read_text(encoding="utf-8")) if path.suffix == ".json" else checkpoint.load(path)
        yield _leaves(content)


def _leaves(value: Any) -> dict[str, Column]:
    return {key: {_NO_FRAME: leaf} for key, leaf in flatten(value).items()}


def _drive_columns(file: DriveReader) -> dict[str, Column]:
    header = {key: value for key, value in file.attrs.items() if key != "params"} | {"params": file.params}
    columns = _leaves(header)
    for name in sorted({*file.names} - {"frame"}):
        columns[name] = _dataset(file, name)
        columns[f"unit of {name}"] = {_NO_FRAME: str(file.dataset(name).attrs.get("unit", ""))}
    return columns


def _dataset(file: DriveReader, name: str) -> Column:
    """Return frame number → value, or a function that reads the value, since files of images exceed the memory.

    A pointer is compared as rows per frame: otherwise one more row in a frame would change all later frames.
    """
    frames, pointer = file.frame.tolist(), file.pointers.get(name)
    if name in PER_DRIVE:
        return {_NO_FRAME: file[name]}
    if name in file.pointers.values():
        return dict(zip(frames, np.diff(file[name]), strict=True))
    if pointer:
        starts = file[pointer]
        ends = zip(frames, starts, starts[1:], strict=False)
        return {frame: partial(file.rows, name, start, stop) for frame, start, stop in ends}
    if len(file.shape(name)) == 1:
        return dict(zip(frames, file[name], strict=True))
    return {frame: partial(file.row, name, row) for row, frame in enumerate(frames)}


@contextmanager
def damage_as_input_error(path: Path, fix: str = "Make it again: dvc repro. Or fetch it: dvc pull") -> Iterator[None]:
    """Convert exceptions of libraries on a damaged file to InputError; errors of the operating system pass unchanged.

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
    with damage_as_input_error(path), DriveReader(path, stage=None) as file:
        yield file


def flatten(value: Any, key: str = "") -> dict[str, Any]:
    """Return dotted key → leaf of nested mappings and lists; a tensor is one leaf, as an array."""
    if hasattr(value, "detach"):  # a tensor; torch is not imported for JSON
        value = value.detach().cpu()
        return {key: (value.float() if str(value.dtype) == "torch.bfloat16" else value).numpy()}
    if isinstance(value, Mapping) and value:
        parts = {f"{key}.{name}" if key else str(name): inner for name, inner in value.items()}
    elif isinstance(value, list | tuple) and value:
        parts = {f"{key}[{number}]": inner for number, inner in enumerate(value)}
    else:
        return {key: value}
    return {name: leaf for part, inner in parts.items() for name, leaf in flatten(inner, part).items()}
