"""Learning curve: which epoch to select, when to stop, and curve.csv."""

import csv
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path

from pipeline.base.atomic import replacing

SMOOTHING = 3  # epochs


@dataclass(frozen=True)
class Epoch:
    """One row of curve.csv. Without validation drives the last two are NaN."""

    epoch: int
    learning_rate: float
    train_loss: float
    val_mse_rad2: float
    val_nmse: float


def selected_epoch(curve: Sequence[Epoch], keep: str) -> int:
    """Return the number of the epoch selected by the rule `train.keep`; the last one without validation.

    best: the lowest validation error; smoothed: the lowest mean over this epoch and the two before, since one epoch's
    error is noisy; last: the last epoch.
    """
    if keep == "last":
        return len(curve)
    length = SMOOTHING if keep == "smoothed" else 1
    error = {
        row.epoch: math.fsum(each.val_nmse for each in curve[max(0, end - length) : end]) / min(length, end)
        for end, row in enumerate(curve, start=1)
    }
    validated = [epoch for epoch in error if not math.isnan(error[epoch])]
    return min(validated, key=error.__getitem__, default=len(curve))


def out_of_patience(curve: Sequence[Epoch], keep: str, patience: int) -> bool:
    """Return whether `patience` epochs have passed since the selected one."""
    return len(curve) - selected_epoch(curve, keep) >= patience


def write_curve(path: Path, curve: Sequence[Epoch]) -> None:
    """Write curve.csv, one row per epoch; NaN becomes an empty field."""
    with replacing(path) as tmp, tmp.open("w", newline="", encoding="utf-8") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(field.name for field in fields(Epoch))
        for row in curve:
            rows.writerow("" if math.isnan(value) else f"{value:.6g}" for value in asdict(row).values())
