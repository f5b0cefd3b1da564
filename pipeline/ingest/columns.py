"""Read columns of numbers from CSV files, and list their faults by column, line and cell."""

import csv
from collections.abc import Mapping
from pathlib import Path

import pandas as pd

from pipeline.base.errors import InputError

# Largest plausible speed of a car in m/s.
LIMIT_MPS = 100.0
# Largest plausible yaw rate of a car in rad/s. KITTI's reach 0.5.
LIMIT_RADPS = 3.0
# Largest plausible angle of the front wheels in rad. The angles of a steering wheel, which are 15
# times as large, exceed it in a tight bend.
LIMIT_RAD = 1.2
# Texts of a cell without a value, in small letters.
EMPTY = ("", "nan", "na", "null", "none")


def read_columns(
    path: Path, limits: Mapping[str, float], expected: str
) -> tuple[pd.DataFrame, list[str]]:
    """Return columns of a file as float64, indexed by line, and a list of their faults.

    A cell is faulty if it is not a number, or an implausible one. A cell that is not a number is
    NaN in the table. `limits` maps the names of the columns to the largest plausible magnitudes.
    All columns but the first may have empty cells. The separator is a comma, a semicolon or a tab.
    Raises InputError, with the hint `expected`, for a missing column.
    """
    header, cells = _read_cells(path, expected)
    missing = [name for name in limits if name not in header]
    if missing:
        raise InputError(
            f"has no column {', '.join(missing)} (got {', '.join(header)})", path, expected
        )

    table = pd.DataFrame(index=cells.index)
    faults = list[str]()
    # Only in the first column, an empty cell is a fault.
    needs_number = True
    for name, limit in limits.items():
        words = cells[header.index(name)].rename(name)
        values = pd.to_numeric(words, errors="coerce").astype(float)
        table[name] = values
        is_faulty = values.isna() & (needs_number | ~_is_empty(words))
        faults += list_fault(words[is_faulty], "is not a number")
        faults += list_fault(words[values.abs() > limit], f"is implausible (limit ±{limit:g})")
        needs_number = False

    # With decimal commas, a line has more cells than line 1 has names.
    for place in cells.columns[len(header) :]:
        nameless = cells.loc[~_is_empty(cells[place]), place].rename(f"cell {place + 1}")
        faults += list_fault(nameless, "has no name in line 1")
    return table, faults


def _is_empty(words: pd.Series) -> pd.Series:
    """Return which cells have no value, bool [N]."""
    return words.str.lower().isin(EMPTY)


def _read_cells(path: Path, expected: str) -> tuple[list[str], pd.DataFrame]:
    """Return the names in line 1 of a CSV file, and the cells of the other lines as text.

    The table is indexed by line, counted from 1. Lines without content are left out. Raises
    InputError.
    """
    lines = path.read_text("utf-8-sig", errors="replace").splitlines() or [""]
    # The separator is the one that is most frequent in line 1. Other lines may have more cells.
    separator = max(",;\t", key=lines[0].count)
    reader = csv.reader(lines, delimiter=separator, skipinitialspace=True, strict=True)
    rows = dict[int, list[str]]()
    try:
        for row in reader:
            rows[reader.line_num] = [cell.strip() for cell in row]
    except csv.Error as error:
        raise InputError(f"is not a CSV file ({error})", path, expected) from error

    width = max(len(row) for row in rows.values())
    header = rows.pop(1)
    filled = {line: row + [""] * (width - len(row)) for line, row in rows.items() if any(row)}
    cells = pd.DataFrame([*filled.values()], [*filled], range(width), dtype=str)
    return header, cells


def list_fault(cells: pd.Series, problem: str, place: str = "line") -> list[str]:
    """Return a list with one text about the faulty `cells` of a column, or an empty list.

    `cells` are indexed by `place`, which is a line of the file or a frame. The text quotes the
    first.
    """
    if cells.empty:
        return []
    index, cell = next(cells.items())
    more = f" and {len(cells) - 1} more" if len(cells) > 1 else ""
    return [f"{cells.name} {problem}: {cell!r:.40} in {place} {index}{more}"]


def check_increase(values: pd.Series, least_step: float) -> list[str]:
    """Return a fault of the `values` that exceed the value before by less than `least_step`."""
    values = values.dropna()
    return list_fault(
        values[values.diff() < least_step], f"does not increase by {least_step:g} or more"
    )


def refuse_faults(faults: list[str], path: Path, fix: str) -> None:
    """Raise InputError with all different `faults` of a file, if there are any."""
    if faults:
        raise InputError("; ".join(dict.fromkeys(faults)), path, fix)
