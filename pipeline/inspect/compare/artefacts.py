"""Two artefacts, files or folders of them: where they differ, one file after the other."""

import filecmp
import json
from collections.abc import Callable, Iterator
from pathlib import Path

from pipeline.base.errors import InputError, error_context
from pipeline.inspect.compare import drives, tables
from pipeline.inspect.compare.difference import Difference
from pipeline.inspect.compare.values import of_values

Compare = Callable[[Path, Path, str, float], Iterator[Difference]]
_BLOCK = 1 << 20


def pairs(a: Path, b: Path) -> list[tuple[str, Path, Path]]:
    """Return what to compare: name, file of A, file of B; of folders, all files of either by their path below.

    Hidden files and folders, as `.resume`, are no artefacts. Raises InputError if one is missing, or a folder and the
    other a file, or files are of two kinds.
    """
    for path in (a, b):
        if not path.exists():
            raise InputError(f"{path} is missing: name two files, or two folders")
    if a.is_dir() != b.is_dir():
        folder, file = (a, b) if a.is_dir() else (b, a)
        raise InputError(f"{folder} is a folder, and {file} is a file: name two of a kind")
    if not a.is_dir():
        if a.suffix != b.suffix:
            raise InputError(f"{a} and {b} are files of two kinds: name two of a kind")
        return [(a.name, a, b)]
    names = sorted({path.relative_to(top) for top in (a, b) for path in top.rglob("*") if path.is_file()})
    shown = [name for name in names if not any(part.startswith(".") for part in name.parts)]
    return [(str(name), a / name, b / name) for name in shown]


def compare(name: str, a: Path, b: Path, tolerance: float) -> Iterator[Difference]:
    """Yield where two files differ: HDF5 by drive, dataset and frame; JSON, CSV, checkpoints by value; others as bytes.

    Files of the same bytes do not. Raises InputError if one is damaged.
    """
    for path, which in ((a, "B"), (b, "A")):
        if not path.is_file():
            yield Difference(name, "", f"only in {which}")
            return
    if filecmp.cmp(a, b, shallow=False):
        return
    yield from _KINDS.get(a.suffix, _bytes)(a, b, name, tolerance)


def _json(a: Path, b: Path, name: str, tolerance: float) -> Iterator[Difference]:
    values = []
    for path in (a, b):
        with error_context(f"{path} is not valid JSON"):
            values.append(json.loads(path.read_text(encoding="utf-8")))
    yield from of_values(values[0], values[1], name, tolerance)


def _checkpoint(a: Path, b: Path, name: str, tolerance: float) -> Iterator[Difference]:
    from pipeline.fitting import checkpoint

    yield from of_values(checkpoint.load(a), checkpoint.load(b), name, tolerance)


def _bytes(a: Path, b: Path, name: str, tolerance: float) -> Iterator[Difference]:
    sizes, at = (a.stat().st_size, b.stat().st_size), 0
    with a.open("rb") as one, b.open("rb") as other:
        while (x := one.read(_BLOCK)) == (y := other.read(_BLOCK)) and x:
            at += len(x)
    at += next((i for i, pair in enumerate(zip(x, y, strict=False)) if pair[0] != pair[1]), min(len(x), len(y)))
    length = f"{sizes[0]} and {sizes[1]} bytes" if sizes[0] != sizes[1] else f"{sizes[0]} bytes"
    yield Difference(name, "", f"{length}, from byte {at} on")


_KINDS: dict[str, Compare] = {
    ".h5": drives.compare,
    ".json": _json,
    ".csv": tables.compare,
    ".pt": _checkpoint,
}
