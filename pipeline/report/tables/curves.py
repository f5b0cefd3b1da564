"""What ``dvc plots`` draws: learning curves, and predicted against driven steering, one CSV file per model and seed.

A model's first seed has file ``<model>.csv``, further ones ``<model>.seed-<n>.csv``, as their folders are named.
"""

import csv
import math
import shutil
from collections.abc import Iterator
from pathlib import Path

from pipeline.base.atomic import replacing
from pipeline.base.errors import explained

COLUMNS = ("row", "drive", "frame", "time_s", "driven_deg", "predicted_deg")


def write_learning(model: Path, out: Path) -> None:
    """Copy the ``curve.csv`` of each seed of a model's folder of stage train to folder `out`."""
    for path, name in _of_seeds(model, "curve.csv"):
        with replacing(out / name) as tmp:
            shutil.copyfile(path, tmp)


def write_steering(model: Path, out: Path) -> None:
    """Write the ``predictions.csv`` of each seed of a model's folder of stage evaluate to folder `out`, in degrees.

    ``row`` counts on over the test drives, one behind the other. Left is positive. Frames before a drive's first
    whole window have no prediction and no line; ``driven_deg`` is empty where the label is invalid.

    Raises:
        InputError: a file holds no numbers.
    """
    for path, name in _of_seeds(model, "predictions.csv"):
        with explained(str(path), hint=f"Make it again: dvc repro --force evaluate@{model.name}"):
            rows = list(_steering(path))
        with replacing(out / name) as tmp, tmp.open("w", newline="", encoding="utf-8") as file:
            lines = csv.writer(file, lineterminator="\n")
            lines.writerow(COLUMNS)
            lines.writerows(rows)


def _steering(path: Path) -> Iterator[tuple[int | str, ...]]:
    """Yield the rows of `COLUMNS` that a file of predictions has an angle for."""
    with path.open(newline="", encoding="utf-8") as file:
        for number, row in enumerate(csv.DictReader(file)):
            if row["predicted_rad"]:
                driven = _degrees(row["steering_rad"]) if row["valid"] == "1" else ""
                yield number, row["drive"], row["frame"], row["time_s"], driven, _degrees(row["predicted_rad"])


def _of_seeds(model: Path, file: str) -> list[tuple[Path, str]]:
    """Return each seed's file of that name in a model's folder, and the name for what is made of it."""
    return [
        (path, ".".join([model.name, *path.relative_to(model).parts[:-1], "csv"]))
        for path in (model / file, *sorted(model.glob(f"seed-*/{file}")))
        if path.is_file()
    ]


def _degrees(angle_rad: str) -> str:
    return f"{math.degrees(float(angle_rad)):.4f}"
