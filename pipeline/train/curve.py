"""Learning curve: select an epoch, stop early, and write curve.csv."""

import csv
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path

from pipeline.base.atomic import replacing

SMOOTHING = 3  # epochs


@dataclass(frozen=True)
class Epoch:
    """One row of curve.csv. Without validation drives, val_nmse is NaN."""

    epoch: int
    learning_rate: float
    train_loss: float
    val_nmse: float


def selected_epoch(curve: Sequence[Epoch]) -> int:
    """Return the number of the epoch whose weights are kept; the last one without validation.

    It has the lowest mean of the validation errors of this epoch and the two before, since one epoch's error is noisy.
    """
    errors = [row.val_nmse for row in curve]
    means = {
        end: math.fsum(errors[max(0, end - SMOOTHING) : end]) / min(SMOOTHING, end) for end in range(1, len(curve) + 1)
    }
    validated = [epoch for epoch, mean in means.items() if not math.isnan(mean)]
    return min(validated, key=means.__getitem__, default=len(curve))


def out_of_patience(curve: Sequence[Epoch], patience: int) -> bool:
    """Return whether `patience` epochs have passed since the selected one."""
    return len(curve) - selected_epoch(curve) >= patience


def write_curve(path: Path, curve: Sequence[Epoch]) -> None:
    """Write curve.csv, one row per epoch; NaN becomes an empty field."""
    with replacing(path) as tmp, tmp.open("w", newline="", encoding="utf-8") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(field.name for field in fields(Epoch))
        for row in curve:
            rows.writerow("" if math.isnan(value) else f"{value:.6g}" for value in asdict(row).values())
