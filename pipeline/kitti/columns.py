"""Read columns of numbers from CSV files, and check them."""

import csv
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from pipeline.base.errors import InputError


def read_columns(path: Path, names: Sequence[str], expected: str, sparse: Sequence[str] = ()) -> dict[str, np.ndarray]:
    """Return name → column, float64 [N], NaN in empty cells of the `sparse` columns.

    The separator is a comma, a semicolon or a tab; other columns are ignored. Raises InputError for a missing file or
    column, with `expected` as the hint; for values that are not numbers; and for rows with more values than the header
    has names, which decimal commas cause.
    """
    if not path.is_file():
        raise InputError("file is missing", path, expected)
    with path.open(encoding="utf-8-sig", errors="replace", newline="") as file:
        separator = max(",;\t", key=file.readline().count)
        file.seek(0)
        reader = csv.DictReader(file, delimiter=separator, skipinitialspace=True, restkey="", restval="")
        reader.fieldnames = found = [name.strip() for name in reader.fieldnames or []]
        if missing := [name for name in names if name not in found]:
            raise InputError(f"has no column {', '.join(missing)} (got {', '.join(found)})", path, expected)
        rows = list[list[float]]()
        for fields in reader:
            try:
                words = [fields[name].strip() or "nan" * (name in sparse) for name in names]
                rows.append([float(word) for word in words])
                if any(surplus.strip() for surplus in fields.get("", [])):
                    raise ValueError
            except ValueError:
                fix = "Write numbers with a decimal point, not a comma"
                where = f"{path} line {reader.line_num}"
                raise InputError("expected numbers, as many as the header names", where, fix) from None
    if not rows:
        raise InputError("has no rows", path, expected)
    return dict(zip(names, np.array(rows, np.float64).reshape(-1, len(names)).T.copy(), strict=True))


def check_limit(name: str, values: np.ndarray, limit: float, path: Path, fix: str) -> None:
    """Raise InputError if one of `values` [N] is not finite or its magnitude exceeds `limit`."""
    wrong = ~(np.abs(values) <= limit)
    if wrong.any():
        at = int(np.argmax(wrong))
        raise InputError(f"implausible {name} = {values[at]:g} at value {at + 1} (limit ±{limit:g})", path, fix)


def check_increase(name: str, values: np.ndarray, least_step: float, path: Path | str) -> None:
    """Raise InputError if one of `values` [N] is less than `least_step` above the one before."""
    wrong = ~(np.diff(values) >= least_step)
    if wrong.any():
        at = int(np.argmax(wrong))
        steps = f"{name} goes from {values[at]:.15g} to {values[at + 1]:.15g} at value {at + 2}"
        problem = f"{steps} (expected an increase of {least_step:g} or more)"
        raise InputError(problem, path, "Correct or remove it")
