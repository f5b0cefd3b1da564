"""Read columns of numbers from CSV files, and list their faults by column, line and cell."""

from collections.abc import Mapping
from pathlib import Path

import pandas as pd

from pipeline.base.errors import InputError

# Largest plausible magnitudes of a car: speed, yaw rate (KITTI's reach 0.5), and angle of the front
# wheels, which the angles of a steering wheel, 15 times as large, exceed in a tight bend.
LIMIT_MPS, LIMIT_RADPS, LIMIT_RAD = 100.0, 3.0, 1.2


def read_columns(
    path: Path, limits: Mapping[str, float], expected: str
) -> tuple[pd.DataFrame, list[str]]:
    """Return float64 columns by line of the file, and faults: cells that are no numbers (NaN), or
    implausible ones.

    `limits`: names of the columns → largest plausible magnitudes. All columns but the first may
    have empty cells. The separator is a comma, a semicolon or a tab. Raises InputError, with the
    hint `expected`, for a missing column.
    """
    if b"\0" in path.read_bytes():  # of Excel's Unicode text, and of PowerShell's files
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
    separator = max(",;\t", key=lines[0].count)
    places = range(1 + max(line.count(separator) for line in lines))
    text = {
        "dtype": str,
        "encoding": "utf-8-sig",
        "encoding_errors": "replace",
        "skipinitialspace": True,
    }
    try:
        cells = pd.read_csv(
            path, sep=separator, header=None, names=places, skip_blank_lines=False, **text
        )
    except ValueError as error:
        raise InputError(f"is not a CSV file ({error})", path, expected) from error
    header = cells.iloc[0].fillna("").str.strip().tolist()[: 1 + lines[0].count(separator)]
    if missing := [name for name in limits if name not in header]:
        raise InputError(
            f"has no column {', '.join(missing)} (got {', '.join(header)})", path, expected
        )
    cells = cells.set_axis(cells.index + 1)[1:].dropna(how="all")
    table, faults = pd.DataFrame(index=cells.index), list[str]()
    for name, limit in limits.items():
        words = cells[header.index(name)].rename(name)
        values = table[name] = pd.to_numeric(words, errors="coerce").astype(float)
        needed = words.notna() | (name == next(iter(limits)))
        faults += fault(words[needed & values.isna()], "is not a number")
        faults += fault(words[values.abs() > limit], f"is implausible (limit ±{limit:g})")
    for place in places[len(header) :]:  # of decimal commas
        faults += fault(cells[place].dropna().rename(f"cell {place + 1}"), "has no name in line 1")
    return table, faults


def fault(cells: pd.Series, problem: str) -> list[str]:
    """Return a line with the first of the wrong `cells` of a column, by line of the file; nothing
    if there are none.
    """
    more = f" and {len(cells) - 1} more" if len(cells) > 1 else ""
    return [
        f"{cells.name} {problem}: {cell!r:.40} in line {line}{more}"
        for line, cell in cells.head(1).items()
    ]


def check_increase(values: pd.Series, least_step: float) -> list[str]:
    """Return a fault of the `values` that are less than `least_step` above the one before."""
    values = values.dropna()
    return fault(values[values.diff() < least_step], f"does not increase by {least_step:g} or more")


def refuse(faults: list[str], path: Path, fix: str) -> None:
    """Raise InputError with all different `faults` of a file, if there are any."""
    if faults:
        raise InputError("; ".join(dict.fromkeys(faults)), path, fix)
