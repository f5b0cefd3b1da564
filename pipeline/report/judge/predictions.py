"""Write predictions.csv: true, predicted and measured steering of the test drives, frame by frame."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from pipeline.base.atomic import replacing
from pipeline.report.judge import decisions
from pipeline.train.predict import Prediction
from pipeline.train.windows import Drive


def write(path: Path, predictions: Sequence[tuple[Drive, Prediction]]) -> None:
    """Write one row per frame; an empty field is an angle that does not exist.

    `frame`, `time_s` and `speed_mps` are those of the last input frame, `onset` is 1 where a turn begins
    (decisions.py). `steering_rad` (true), `predicted_rad` and `valid` are those `horizon` frames later, and
    `odometry_rad` is the angle measured at the last input frame, which the baseline `odometry` predicts. Models with
    uncertainty have a last column `sigma_rad`, the standard deviation of the predicted angle.
    """
    import pandas as pd

    tables = []
    for drive, predicted in predictions:
        table = {
            "drive": drive.name,
            "frame": drive.frame,
            "time_s": _text(drive.time_s, 6),
            "speed_mps": _text(drive.speed_mps, 4),
            "steering_rad": _text(drive.steering_rad, 9),
            "predicted_rad": _text(predicted.steering_rad, 6),
            "valid": drive.valid.astype(int),
            "onset": np.isin(drive.frame, decisions.frames(drive)).astype(int),
            "odometry_rad": _text(_odometry(drive), 6),
        }
        if predicted.sigma_rad is not None:
            table["sigma_rad"] = _text(predicted.sigma_rad, 6)
        tables.append(pd.DataFrame(table))
    with replacing(path) as unfinished:
        pd.concat(tables).to_csv(unfinished, index=False, lineterminator="\n")


def _odometry(drive: Drive) -> np.ndarray:
    """Return the angle of the first kind of motion in the drive's graph file, [G] rad; NaN without motion."""
    return next(iter(drive.measured_rad.values()), np.full(len(drive.frame), np.nan))


def _text(values: np.ndarray, digits: int) -> list[str]:
    return ["" if np.isnan(value) else f"{value:.{digits}f}" for value in values]
