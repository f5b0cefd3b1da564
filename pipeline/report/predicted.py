"""What models predicted for the test drives, as their predictions.csv say it."""

import csv
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from pipeline.base.errors import error_context
from pipeline.report.judge.paths import Track


@dataclass(frozen=True)
class Steering:
    """A model's first seed on one drive, F frames; angles in degrees, left +, NaN where there is none to compare."""

    frame: np.ndarray  # int [F], KITTI frame numbers
    time_s: np.ndarray  # [F], since the drive's first frame
    speed_mps: np.ndarray  # [F]
    onset: np.ndarray  # bool [F], where the driver begins a turn
    recorded_deg: np.ndarray  # [F], valid or not
    driven_deg: np.ndarray  # [F], NaN where it is not valid
    predicted_deg: np.ndarray  # [F]

    @property
    def comparable(self) -> np.ndarray:
        """Which frames [F] have both angles."""
        return ~np.isnan(self.driven_deg) & ~np.isnan(self.predicted_deg)

    def track(self, wheelbase_m: float, formula: Literal["bicycle", "paper"]) -> Track:
        """Return what the drive's path is made of."""
        steering_rad = np.deg2rad(np.nan_to_num(self.recorded_deg))
        return Track(self.time_s, self.speed_mps, steering_rad, np.flatnonzero(self.onset), wheelbase_m, formula)


def read(model: Path) -> dict[str, Steering]:
    """Read drive → steering from a model's folder of stage evaluate. Raises InputError if its file is damaged."""
    path = model / "predictions.csv"
    rows: dict[str, list[tuple[float, ...]]] = {}
    with (
        error_context(str(path), fix=f"Make it again: dvc repro --force --single-item evaluate@{model.name}"),
        path.open(newline="", encoding="utf-8") as file,
    ):
        try:
            for row in csv.DictReader(file):
                recorded = _degrees(row["steering_rad"])
                driven = recorded if row["valid"] == "1" else math.nan
                known = (float(row[name]) for name in ("frame", "time_s", "speed_mps", "onset"))
                rows.setdefault(row["drive"], []).append((*known, recorded, driven, _degrees(row["predicted_rad"])))
        except KeyError as error:
            raise ValueError(f"has no column {error}") from error
    return {drive: _steering(np.array(of_drive)) for drive, of_drive in rows.items()}


def _steering(rows: np.ndarray) -> Steering:
    frame, time_s, speed_mps, onset, *angles = rows.T
    return Steering(frame.astype(int), time_s - time_s[0], speed_mps, onset.astype(bool), *angles)


def _degrees(angle_rad: str) -> float:
    return math.degrees(float(angle_rad)) if angle_rad else math.nan
