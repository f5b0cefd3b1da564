"""Read columns of numbers from CSV files, and check them."""

import csv
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from pipeline.base.errors import InputError


def read_columns(
    path: Path, required: Sequence[str], optional: Sequence[str], expected: str, least: int = 0
) -> dict[str, np.ndarray]:
    """Return name → column, float64 [N], for the `required` and those of the `optional` columns that the file has.

    The separator is a comma, a semicolon or a tab; other columns are ignored. Raises InputError for a missing file or
    column, which ends with the sentence `expected`; for values that are not numbers; and for rows with more values than
    the header has names, as decimal commas give.
    """
    if not path.is_file():
        raise InputError("file is missing", path, expected)
    with path.open(encoding="utf-8-sig", errors="replace", newline="") as file:
        separator = max(",;\t", key=file.readline().count)
        file.seek(0)
        reader = csv.reader(file, delimiter=separator, skipinitialspace=True)
        names = [name.strip() for name in next(reader, [])]
        if missing := [name for name in required if name not in names]:
            raise InputError(f"has no column {', '.join(missing)} (got {', '.join(names)})", path, expected)
        columns = {name: names.index(name) for name in (*required, *optional) if name in names}
        rows: list[list[float]] = []
        for fields in reader:
            where = f"{path} line {reader.line_num}"
            if any(field.strip() for field in fields[len(names) :]):
                problem = f"has {len(fields)} values, the header {len(names)} names"
                raise InputError(problem, where, "Write numbers with a decimal point, not a comma")
            if fields:
                try:
                    rows.append([float(fields[column]) for column in columns.values()])
                except (ValueError, IndexError):
                    problem = f"expected numbers in {', '.join(columns)}, got {separator.join(fields)!r}"
                    raise InputError(problem, where, "Correct or remove the line") from None
    if len(rows) < least:
        raise InputError(f"expected at least {least} samples, got {len(rows)}", path)
    table = np.array(rows, np.float64).reshape(-1, len(columns))
    return {name: table[:, at].copy() for at, name in enumerate(columns)}


def check_limit(
    name: str, values: np.ndarray, limit: float, path: Path, fix: str = "Correct or remove the sample"
) -> None:
    """Raise InputError if one of `values` [N] is not finite or its magnitude exceeds `limit`."""
    wrong = ~(np.abs(values) <= limit)
    if wrong.any():
        at = int(np.argmax(wrong))
        raise InputError(f"implausible {name} = {values[at]:g} at sample {at + 1} (limit ±{limit:g})", path, fix)


def check_increase(name: str, values: np.ndarray, least_step: float, path: Path) -> None:
    """Raise InputError if one of `values` [N] is less than `least_step` above the one before."""
    wrong = ~(np.diff(values) >= least_step)
    if wrong.any():
        at = int(np.argmax(wrong))
        problem = f"{name} goes from {values[at]:.15g} to {values[at + 1]:.15g} at sample {at + 2}"
        fix = "Sort the file and remove repeated rows"
        raise InputError(f"{problem} (expected an increase of {least_step:g} or more)", path, fix)
