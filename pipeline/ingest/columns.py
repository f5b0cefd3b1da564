"""Read columns of numbers from CSV files, and list their faults by column, line and cell."""

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


def read_columns(
    path: Path, limits: Mapping[str, float], expected: str
) -> tuple[pd.DataFrame, list[str]]:
    """Return columns of a file as float64, indexed by line, and a list of their faults.

    A cell is faulty if it is not a number, or an implausible one. A cell that is not a number is
    NaN in the table. `limits` maps the names of the columns to the largest plausible magnitudes.
    All columns but the first may have empty cells. The separator is a comma, a semicolon or a tab.
    Raises InputError, with the hint `expected`, for a missing column.
    """
    cells, header = _read_cells(path, expected)
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
        faults += fault(words[values.isna() & (words.notna() | needs_number)], "is not a number")
        faults += fault(words[values.abs() > limit], f"is implausible (limit ±{limit:g})")
        needs_number = False

    # With decimal commas, a line has more cells than line 1 has names.
    for place in cells.columns[len(header) :]:
        nameless = cells[place].dropna().rename(f"cell {place + 1}")
        faults += fault(nameless, "has no name in line 1")
    return table, faults


def _read_cells(path: Path, expected: str) -> tuple[pd.DataFrame, list[str]]:
    """Return the cells of a CSV file as text, by line and place, and the names in its first line.

    Lines without content are left out. Raises InputError.
    """
    # Excel's "Unicode text" and PowerShell's files are in UTF-16, which has zero bytes.
    if b"\0" in path.read_bytes():
        raise InputError(
            "is in UTF-16",
            path,
            f"Save it as UTF-8: iconv -f UTF-16 -t UTF-8 {path.name} > utf8.csv",
        )
    lines = path.read_text("utf-8-sig", errors="replace").splitlines() or [""]
    if lines[0].startswith("sep="):
        raise InputError(
            "line 1 is Excel's separator, not the names of columns",
            path,
            f"Remove line 1: {lines[0]}",
        )

    # The separator is the one that is most frequent in line 1. Other lines may have more cells.
    separator = max(",;\t", key=lines[0].count)
    most_separators = max(line.count(separator) for line in lines)
    try:
        cells = pd.read_csv(
            path,
            sep=separator,
            header=None,
            names=range(1 + most_separators),
            skip_blank_lines=False,
            dtype=str,
            encoding="utf-8-sig",
            encoding_errors="replace",
            skipinitialspace=True,
        )
    except ValueError as error:
        raise InputError(f"is not a CSV file ({error})", path, expected) from error
    # Lines are counted from 1. Line 1 has the names.
    header = cells.iloc[0].fillna("").str.strip().tolist()[: 1 + lines[0].count(separator)]
    return cells.set_axis(cells.index + 1)[1:].dropna(how="all"), header


def fault(cells: pd.Series, problem: str) -> list[str]:
    """Return a list with one text about the faulty `cells` of a column, or an empty list.

    `cells` are indexed by line of the file. The text quotes the first.
    """
    if cells.empty:
        return []
    line, cell = next(cells.items())
    more = f" and {len(cells) - 1} more" if len(cells) > 1 else ""
    return [f"{cells.name} {problem}: {cell!r:.40} in line {line}{more}"]


def check_increase(values: pd.Series, least_step: float) -> list[str]:
    """Return a fault of the `values` that exceed the value before by less than `least_step`."""
    values = values.dropna()
    return fault(values[values.diff() < least_step], f"does not increase by {least_step:g} or more")


def refuse(faults: list[str], path: Path, fix: str) -> None:
    """Raise InputError with all different `faults` of a file, if there are any."""
    if faults:
        raise InputError("; ".join(dict.fromkeys(faults)), path, fix)
