"""Write predictions.csv: the columns of the test drives frame by frame."""

import csv
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.base.atomic import replacing
from pipeline.evaluate.metrics import Case


def write_predictions(path: Path, cases: Sequence[Case], seed: int) -> None:
    """Write one row per frame with the predictions of seed number `seed`; unknown values are empty fields.

    `frame`, `time_s` and `speed_mps` are those of the last input frame, `onset` is 1 where a turn begins
    (decisions.py). For each column C of the model, `true_C` and `predicted_C` are those `horizon` frames later,
    `odometry_C` is measured at the last input frame, and models with uncertainty have `sigma_C`.
    """
    with replacing(path) as tmp, tmp.open("w", newline="", encoding="utf-8") as file:
        rows = csv.writer(file, lineterminator="\n")
        for number, case in enumerate(cases):
            columns = _columns(case, seed)
            if not number:
                rows.writerow(columns)
            rows.writerows(zip(*columns.values(), strict=True))


def _columns(case: Case, seed: int) -> dict[str, Iterable[Any]]:
    drive, predicted = case.drive, case.predictions[seed]
    columns: dict[str, Iterable[Any]] = {
        "drive": [drive.name] * len(drive.frame),
        "frame": drive.frame,
        "time_s": _text(drive.time_s, 6),
        "speed_mps": _text(drive.speed_mps, 4),
        "onset": np.isin(drive.frame, case.turns.frame).astype(int),
    }
    odometry = np.full_like(drive.truth, np.nan) if drive.odometry is None else drive.odometry
    for number, name in enumerate(drive.columns):
        columns[f"true_{name}"] = _text(drive.truth[:, number], 9)
        columns[f"predicted_{name}"] = _text(predicted.mean[:, number], 6)
        columns[f"odometry_{name}"] = _text(odometry[:, number], 6)
        if predicted.sigma is not None:
            columns[f"sigma_{name}"] = _text(predicted.sigma[:, number], 6)
    return columns


def _text(values: np.ndarray, digits: int) -> Iterator[str]:
    """Return numbers with `digits` decimals, NaN as an empty text."""
    return ("" if np.isnan(value) else f"{value:.{digits}f}" for value in values)
