"""The epochs of a training run: which one's weights are kept, when it is time to stop, and curve.csv."""

import csv
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path

from pipeline.base.atomic import replacing

SMOOTHED = 3  # epochs


@dataclass(frozen=True)
class Epoch:
    """One row of curve.csv. Without validation drives the last two are NaN."""

    epoch: int
    learning_rate: float
    train_loss: float
    val_mse_rad2: float
    val_nmse: float


def kept_epoch(curve: Sequence[Epoch], keep: str) -> int:
    """Return the number of the epoch whose average a rule of `train.keep` takes; the last if nothing was validated.

    One epoch's validation error is noise as much as merit: `smoothed` takes it as a mean with that of the two epochs
    before, and `last` does not ask it.
    """
    if keep == "last":
        return len(curve)
    over = SMOOTHED if keep == "smoothed" else 1
    error = {
        row.epoch: math.fsum(each.val_nmse for each in curve[max(0, end - over) : end]) / min(over, end)
        for end, row in enumerate(curve, start=1)
    }
    judged = [epoch for epoch in error if not math.isnan(error[epoch])]
    return min(judged, key=error.__getitem__, default=len(curve))


def out_of_patience(curve: Sequence[Epoch], keep: str, patience: int) -> bool:
    """Whether `patience` epochs have come after the one that is kept."""
    return len(curve) - kept_epoch(curve, keep) >= patience


def write_curve(path: Path, curve: Sequence[Epoch]) -> None:
    """Write curve.csv, one row per epoch; what was not measured stays empty."""
    with replacing(path) as tmp, tmp.open("w", newline="", encoding="utf-8") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(field.name for field in fields(Epoch))
        for row in curve:
            rows.writerow("" if math.isnan(value) else f"{value:.6g}" for value in asdict(row).values())
