"""predictions.csv: each frame with what was predicted by what is seen until then, and what was driven.

`onset` is 1 where the driver begins a turn (decisions.py).

Both angles are those `horizon` frames after it, and so is `valid`; number, time and speed are the frame's own.
"""

import csv
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from pipeline.base.atomic import replacing
from pipeline.report.judge import decisions
from pipeline.train.windows import Drive

COLUMNS = ("drive", "frame", "time_s", "speed_mps", "steering_rad", "predicted_rad", "valid", "onset")


def write(path: Path, predictions: Sequence[tuple[Drive, np.ndarray]]) -> None:
    """Write one row per frame of drives with what is predicted for them, [G] rad; an angle that is NaN stays empty."""
    with replacing(path) as tmp, tmp.open("w", newline="", encoding="utf-8") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(COLUMNS)
        for drive, predicted in predictions:
            onset = np.isin(drive.frame, decisions.frames(drive))
            for row in range(len(drive.frame)):
                rows.writerow([
                    drive.name, drive.frame[row], f"{drive.time_s[row]:.6f}", f"{drive.speed_mps[row]:.4f}",
                    _angle(drive.steering_rad[row], 9), _angle(predicted[row], 6), int(drive.valid[row]),
                    int(onset[row]),
                ])  # fmt: skip


def _angle(rad: float, digits: int) -> str:
    return "" if np.isnan(rad) else f"{rad:.{digits}f}"
