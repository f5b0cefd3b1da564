"""Two CSV files: matched by drive and frame where they have such columns, else by row."""

import csv
from collections.abc import Iterator
from itertools import count
from pathlib import Path

import numpy as np

from pipeline.base.errors import InputError, error_context
from pipeline.inspect.compare.difference import Difference, Tally

Key = tuple[str, int]  # drive or "", frame or row
Rows = dict[Key, dict[str, str]]


def compare(a: Path, b: Path, name: str, tolerance: float) -> Iterator[Difference]:
    """Yield where two CSV files differ, by drive and column. Raises InputError if one is damaged."""
    (columns, one), (others, other) = _read(a), _read(b)
    for column in dict.fromkeys([*columns, *others]):
        if (column in columns) != (column in others):
            yield Difference(name, column, f"only in {'A' if column in columns else 'B'}")
    for which, alone in (("A", one.keys() - other.keys()), ("B", other.keys() - one.keys())):
        if alone:
            drive, row = min(alone)
            how = f"{len(alone)} rows only in {which}, first {' '.join(filter(None, [drive, str(row)]))}"
            yield Difference(name, "", how)
    common = [key for key in one if key in other]
    for drive in dict.fromkeys(drive for drive, _ in common):
        keys = [key for key in common if key[0] == drive]
        for column in (column for column in columns if column in others):
            found = Tally(tolerance)
            for key in keys:
                found.add(*_cells(one[key][column], other[key][column]), key[1])
            difference = found.difference(name, column, drive=drive or None)
            if difference:
                yield difference


def _read(path: Path) -> tuple[list[str], Rows]:
    rows: Rows = {}
    numbers = count()
    with error_context(str(path)), path.open(newline="", encoding="utf-8") as file:
        try:
            reader = csv.DictReader(file, restval="", strict=True)
            columns = list(reader.fieldnames or [])
            for row in reader:
                by_frame = row.get("frame", "").isdecimal()
                rows[row.get("drive", ""), int(row["frame"]) if by_frame else next(numbers)] = row
        except csv.Error as error:
            raise InputError(f"{path} is not valid CSV: {error}") from error
    return columns, rows


def _cells(a: str, b: str) -> tuple[np.ndarray, np.ndarray]:
    try:
        return np.array([float(a)]), np.array([float(b)])
    except ValueError:
        return np.array([a]), np.array([b])
