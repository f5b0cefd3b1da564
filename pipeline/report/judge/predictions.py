"""predictions.csv: each frame with what was driven and what was predicted."""

import csv
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from pipeline.base.atomic import replacing
from pipeline.train.windows import Drive

COLUMNS = ("drive", "frame", "time_s", "speed_mps", "steering_rad", "predicted_rad", "valid")


def write(path: Path, drives: Sequence[Drive], predicted_rad: Sequence[np.ndarray]) -> None:
    """Write one row per frame of `drives`; of predictions [G] rad of each drive, NaN stays empty."""
    with replacing(path) as tmp, tmp.open("w", newline="", encoding="utf-8") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(COLUMNS)
        for drive, predicted in zip(drives, predicted_rad, strict=True):
            for row in range(len(drive.frame)):
                angle = "" if np.isnan(predicted[row]) else f"{predicted[row]:.6f}"
                rows.writerow([
                    drive.name, drive.frame[row], f"{drive.time_s[row]:.6f}", f"{drive.speed_mps[row]:.4f}",
                    f"{drive.steering_rad[row]:.9f}", angle, int(drive.valid[row]),
                ])  # fmt: skip
