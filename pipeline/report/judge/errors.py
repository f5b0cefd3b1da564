"""Errors of steering predictions, all together and by curvature. Angles in rad unless named deg."""

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from pipeline.train import score


def scores(steering_rad: np.ndarray, predicted_rad: np.ndarray) -> dict[str, Any]:
    """Return mse_rad2, rmse_deg, mae_deg and nmse of predictions [N], or of S seeds' predictions [S,N] on average.

    nmse = MSE / MSE of always predicting zero: 1 is useless, 0 perfect, None where every label is 0. Of no frames at
    all, each is None.
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
) -> list[dict[str, Any]]:
    """Return the scores within bins of |curvature|, straightest first: a model that only drives straight shows here.

    Beside them, as `zero`, those of always predicting zero. A bin without a frame has `frames` 0 and nothing else.
    """
    bounds = [0.0, *edges, np.inf]
    rows = []
    for low, high in pairwise(bounds):
        inside = (np.abs(curvature_1pm) >= low) & (np.abs(curvature_1pm) < high)
        row: dict[str, Any] = {"from_1pm": low, "to_1pm": None if np.isinf(high) else high, "frames": 0}
        if inside.any():
            row |= scores(steering_rad[inside], predicted_rad[..., inside])
            row["zero"] = scores(steering_rad[inside], np.zeros(inside.sum()))
        rows.append(row)
    return rows
