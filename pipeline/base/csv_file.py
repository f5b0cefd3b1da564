"""Read columns of numbers from a CSV file that another program wrote."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from pipeline.base.errors import InputError


def read_columns(path: Path, required: Sequence[str], optional: Sequence[str], expected: str) -> dict[str, np.ndarray]:
    """Return name → column, float64 [N], for the `required` and those of the `optional` columns that the file has.

    The separator is a comma, a semicolon or a tab; other columns are ignored. Raises InputError, which ends with the
    sentence `expected`, for a missing column, and for values that are not numbers.
    """
    import pandas as pd

    with path.open(encoding="utf-8-sig", errors="replace") as file:
        header = file.readline(1 << 16)
    separator = max(",;\t", key=header.count)
    names = [name.strip(' "\r\n') for name in header.split(separator)]
    missing = [name for name in required if name not in names]
    if missing:
        raise InputError(f"has no column {', '.join(missing)} (got {', '.join(names)})", path, expected)
    columns = [*required, *(name for name in optional if name in names)]
    try:
        table = pd.read_csv(
            path,
            sep=separator,
            header=0,
            names=names,
            index_col=False,
            usecols=columns,
            dtype=np.float64,
            skipinitialspace=True,
            encoding="utf-8-sig",
            encoding_errors="replace",
        )
    except ValueError as error:  # pandas' parser errors too
        raise InputError(f"is not a table of numbers ({error})", path, "Correct or remove the line") from error
    return {name: table[name].to_numpy() for name in columns}
