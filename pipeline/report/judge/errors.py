"""Compute errors of steering predictions and of baselines, overall and by curvature. Angles in rad unless named deg."""

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from pipeline.train import score

Scores = dict[str, Any]


def scores(steering_rad: np.ndarray, predicted_rad: np.ndarray) -> Scores:
    """Return frames, mse_rad2, rmse_deg, mae_deg and nmse of predictions [N], or the mean over S seeds [S,N].

    nmse = MSE / MSE of always predicting zero: 0 is perfect, 1 is useless, None if every label is 0. Without frames,
    all errors are None.
    """
    if not len(steering_rad):
        return {"frames": 0, **dict.fromkeys(("mse_rad2", "rmse_deg", "mae_deg", "nmse"))}
    mse, nmse = score.mse(steering_rad, predicted_rad), score.nmse(steering_rad, predicted_rad)
    return {
        "frames": len(steering_rad),
        "mse_rad2": mse,
        "rmse_deg": float(np.rad2deg(np.sqrt(mse))),
        "mae_deg": float(np.rad2deg(np.mean(np.abs(predicted_rad - steering_rad)))),
        "nmse": None if np.isnan(nmse) else nmse,
    }


def by_curvature(
    steering_rad: np.ndarray, predicted_rad: np.ndarray, curvature_1pm: np.ndarray, edges: Sequence[float]
) -> list[Scores]:
    """Return the scores in bins of |curvature|, straightest first, each with the scores of predicting `zero`.

    A model that always drives straight ahead has a small mean error, but not in the bins of bends. A bin without frames
    has only its bounds and `frames` 0.
    """
    rows = []
    for low, high in pairwise([0.0, *edges, np.inf]):
        inside = (np.abs(curvature_1pm) >= low) & (np.abs(curvature_1pm) < high)
        row: Scores = {"from_1pm": low, "to_1pm": None if np.isinf(high) else high, "frames": 0}
        if inside.any():
            row |= scores(steering_rad[inside], predicted_rad[..., inside])
            row["zero"] = scores(steering_rad[inside], np.zeros(inside.sum()))
        rows.append(row)
    return rows


def baselines(
    steering_rad: np.ndarray,
    train_mean_rad: np.ndarray | float,
    persistence_rad: np.ndarray,
    measured_rad: Mapping[str, np.ndarray],
) -> dict[str, Scores]:
    """Return the scores of predictors that do not use the scene, for target angles [N].

    - zero: always straight ahead.
    - train_mean: the mean of the training targets.
    - persistence: `persistence_rad` [N], the last true angle before the target frame. No model gets it as input.
    - odometry: the angle measured at the last input frame; `measured_rad` maps the kind of motion to [N]. The first
      kind is `odometry`, a second one `odometry_<kind>`. Its errors are None if some angles are NaN, as in a drive
      without scans.
    """
    predictions = {
        "zero": np.zeros_like(steering_rad),
        "train_mean": np.full_like(steering_rad, train_mean_rad),
        "persistence": persistence_rad,
    }
    for number, (kind, angle) in enumerate(measured_rad.items()):
        predictions[f"odometry_{kind}" if number else "odometry"] = angle
    found = {}
    for name, predicted in predictions.items():
        rows = slice(0 if np.isnan(predicted).any() else None)
        found[name] = scores(steering_rad[rows], predicted[rows])
    return found
