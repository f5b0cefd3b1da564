"""The trivial predictors that every model stands beside."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from pipeline.report.judge.errors import scores


def baselines(
    steering_rad: np.ndarray,
    train_mean_rad: np.ndarray | float,
    held_rad: np.ndarray,
    measured_rad: Mapping[str, np.ndarray],
) -> dict[str, dict[str, Any]]:
    """Return the scores of predictors that learn nothing of the road, for target angles [N].

    zero: always straight. train_mean: the mean of the training targets. persistence: the last true angle that may be
    known, `held_rad` [N]; it knows what no model is told. odometry: the angle that is measured at the last frame seen,
    of `measured_rad`, kind of motion → [N]: of its first kind, and a further one as odometry_<kind>. It is judged where
    it is known: scores are None of angles some of which are NaN, as those of a drive without scans are.
    """
    by_name = {
        "zero": np.zeros_like(steering_rad),
        "train_mean": np.full_like(steering_rad, train_mean_rad),
        "persistence": held_rad,
    }
    for number, (kind, angle) in enumerate(measured_rad.items()):
        by_name[f"odometry_{kind}" if number else "odometry"] = angle
    known = {name: slice(0 if np.isnan(predicted).any() else None) for name, predicted in by_name.items()}
    return {name: scores(steering_rad[known[name]], predicted[known[name]]) for name, predicted in by_name.items()}
