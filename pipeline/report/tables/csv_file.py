"""Tables as CSV files."""

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pipeline.base.atomic import replacing


def write(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Write rows, column → value, with the columns of the first one; what is None, or lacks, stays empty."""
    with replacing(path) as tmp, tmp.open("w", newline="", encoding="utf-8") as file:
        table = csv.DictWriter(file, list(rows[0]) if rows else [], lineterminator="\n")
        table.writeheader()
        table.writerows(rows)
