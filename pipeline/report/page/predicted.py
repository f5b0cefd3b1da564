"""What models predicted for the test drives, as their predictions.csv say it."""

import csv
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pipeline.base.errors import explained


@dataclass(frozen=True)
class Steering:
    """A model's first seed on one drive, F frames; angles in degrees, left +, NaN where there is none to compare."""

    frame: np.ndarray  # int [F], KITTI frame numbers
    time_s: np.ndarray  # [F], since the drive's first frame
    speed_mps: np.ndarray  # [F]
    driven_deg: np.ndarray  # [F], NaN where it is not valid
    predicted_deg: np.ndarray  # [F]

    @property
    def error_deg(self) -> np.ndarray:
        """Predicted minus driven, of the frames [f] that have both."""
        error = self.predicted_deg - self.driven_deg
        return error[~np.isnan(error)]


def read(model: Path) -> dict[str, Steering]:
    """Read drive → steering from a model's folder of stage evaluate. Raises InputError if its file is damaged."""
    path = model / "predictions.csv"
    columns: dict[str, list[tuple[float, ...]]] = {}
    with (
        explained(str(path), hint=f"Make it again: dvc repro --force evaluate@{model.name}"),
        path.open(newline="", encoding="utf-8") as file,
    ):
        try:
            for row in csv.DictReader(file):
                driven = _degrees(row["steering_rad"]) if row["valid"] == "1" else math.nan
                of_drive = columns.setdefault(row["drive"], [])
                of_drive.append(
                    (
                        float(row["frame"]),
                        float(row["time_s"]),
                        float(row["speed_mps"]),
                        driven,
                        _degrees(row["predicted_rad"]),
                    )
                )
        except KeyError as error:
            raise ValueError(f"has no column {error}") from error
    return {drive: _steering(np.array(rows)) for drive, rows in columns.items()}


def _steering(rows: np.ndarray) -> Steering:
    frame, time_s, *others = rows.T
    return Steering(frame.astype(int), time_s - time_s[0], *others)


def _degrees(angle_rad: str) -> float:
    return math.degrees(float(angle_rad)) if angle_rad else math.nan
