"""What ``dvc plots`` draws: learning curves, and predicted against driven steering, one CSV file per run of a model.

A model's first seed has file ``<model>.csv``, further ones ``<model>.seed-<n>.csv``, as their folders are named; the
networks of folds have ``<model>.fold-<drive>.csv`` and ``<model>.seed-<n>.fold-<drive>.csv``.
"""

import csv
import math
from collections.abc import Callable
from pathlib import Path

from pipeline.base.errors import error_context
from pipeline.report.tables import csv_file

Row = dict[str, str]  # of a CSV file: column → value


def write_learning(model: Path, out: Path) -> None:
    """Write the learning curve of each run in a model's folder of stage train to folder `out`.

    Columns: ``epoch``, ``train_loss``, ``val_nmse``. Raises InputError if a ``curve.csv`` lacks one.
    """

    def row_of(_: int, row: Row) -> Row:
        return {column: row[column] for column in ("epoch", "train_loss", "val_nmse")}

    _write(model, "curve.csv", row_of, out, stage="train")


def write_steering(model: Path, out: Path) -> None:
    """Write the steering on the test drives by each seed of a model's folder of stage evaluate to folder `out`.

    Columns: ``row``, which counts on over drives one behind the other; ``drive``, ``frame``, ``time_s``; ``driven_deg``
    and ``predicted_deg``, left is positive. Raises InputError if a ``predictions.csv`` does not hold them.
    """

    def row_of(number: int, row: Row) -> Row:
        driven = _degrees(row["steering_rad"]) if row["valid"] == "1" else ""
        same = {column: row[column] for column in ("drive", "frame", "time_s")}
        return {"row": str(number), **same, "driven_deg": driven, "predicted_deg": _degrees(row["predicted_rad"])}

    _write(model, "predictions.csv", row_of, out, stage="evaluate")


def _write(model: Path, name: str, row_of: Callable[[int, Row], Row], out: Path, stage: str) -> None:
    """Write what `row_of` makes of the rows of each run's file `name`, one file each; none of a model not here."""
    for path in sorted(model.rglob(name)):
        with error_context(str(path), fix=f"Make it again: dvc repro --force --single-item {stage}@{model.name}"):
            rows = _read(path, row_of)
        made = ".".join([model.name, *path.relative_to(model).parts[:-1], "csv"])
        # DVC draws an empty field as 0, and nan as a gap.
        csv_file.write(out / made, [{column: value or "nan" for column, value in row.items()} for row in rows])


def _read(path: Path, row_of: Callable[[int, Row], Row]) -> list[Row]:
    with path.open(newline="", encoding="utf-8") as file:
        try:
            return [row_of(number, row) for number, row in enumerate(csv.DictReader(file))]
        except KeyError as error:
            raise ValueError(f"has no column {error}") from error


def _degrees(angle_rad: str) -> str:
    """Convert an angle; what is empty stays so."""
    return angle_rad and f"{math.degrees(float(angle_rad)):.4f}"
