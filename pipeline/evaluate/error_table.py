"""Compute the errors of predictions, and the differences between two methods, as tables.

A method is a model or a baseline. Letters: S seeds of a model, N frames, R columns of the predicted
quantity.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from pipeline.base.errors import InputError
from pipeline.evaluate import statistics
from pipeline.evaluate.drift import measure_drift
from pipeline.evaluate.own_metrics import METRICS
from pipeline.evaluate.settings import BASELINES, NO_LEARNING, Evaluate
from pipeline.train.quantity import Quantity


@dataclass(frozen=True)
class Predictions:
    """What methods predict of a quantity in the same N frames."""

    quantity: Quantity
    frames: pd.DataFrame  # columns drive, frame, time_s and speed_mps [N], in time order
    truth: np.ndarray  # true values [N,R], NaN in frames that do not count
    predicted: dict[str, np.ndarray]  # method → predictions [S,N,R]

    @property
    def models(self) -> list[str]:
        """The methods that are no baselines."""
        return [name for name in self.predicted if name not in BASELINES]

    @property
    def drive(self) -> np.ndarray:
        """The number [N] of each frame's drive."""
        number, _ = self.frames["drive"].factorize()
        return number

    @property
    def ranges(self) -> dict[str, list[int]]:
        """Name of a range → its columns. The range without a name has all columns."""
        ranges = {"": [*range(len(self.quantity.columns))]}
        for column, label in enumerate(self.quantity.ranges):
            if label:
                ranges[label] = [column]
        return ranges


def common_frames(tables: Mapping[str, pd.DataFrame], quantity: Quantity) -> Predictions:
    """Return the predictions of models for the frames of all their drives.

    `tables` is model → its table of predictions. A frame counts if it has a valid true value, and
    if every model and seed predicts it. If several models have a baseline, it is that of the first
    model. A baseline is used if it has a value wherever the truth has one.
    """
    indexed = {model: table.set_index(["drive", "frame"]) for model, table in tables.items()}
    frames = pd.concat(indexed.values()).groupby(level=[0, 1]).first()

    def values(table: pd.DataFrame, kind: str) -> np.ndarray:
        names = [f"{kind}_{column}" for column in quantity.columns]
        return table.reindex(frames.index).reindex(columns=names).to_numpy(float)

    truth = values(frames, "true")
    predicted = {}
    for model, table in indexed.items():
        seeds = [values(of_seed, "predicted") for _, of_seed in table.groupby("seed", sort=False)]
        predicted[model] = np.stack(seeds)
        truth = np.where(np.isfinite(predicted[model]).all(axis=0), truth, np.nan)

    # The first baseline, zero, is not in the tables.
    baselines = {"zero": np.zeros_like(truth)}
    for name in BASELINES[1:]:
        baselines[name] = values(frames, name)

    # Before the first measurement, odometry is 0, as in the regression.
    before = np.isnan(baselines["odometry"]) & np.isfinite(baselines["regression"])
    baselines["odometry"] = np.where(before, 0.0, baselines["odometry"])

    for name, value in baselines.items():
        if np.isfinite(value[np.isfinite(truth)]).all():
            predicted[name] = value[None]
    columns = ["drive", "frame", "time_s", "speed_mps"]
    return Predictions(quantity, frames.reset_index()[columns], truth, predicted)


def error_table(
    predictions: Predictions, methods: Sequence[str], settings: Evaluate
) -> pd.DataFrame:
    """Return the errors of methods, with the index (range, method)."""
    rows = {}
    for label, columns in predictions.ranges.items():
        for method in methods:
            rows[label, method] = _method_errors(predictions, method, columns, settings)
    for method in methods:
        rows["", method]["drift"] = _mean_drift(predictions, method)
    return pd.DataFrame.from_dict(rows, orient="index", dtype=object)


def compare_methods(predictions: Predictions, settings: Evaluate) -> pd.DataFrame:
    """Return the paired differences in nmse of models, with the index (range, "MODEL - RIVAL").

    A rival is another model, or a baseline that does not get the truth.
    """
    rivals = predictions.models + [name for name in NO_LEARNING if name in predictions.predicted]
    rows = {}
    for label, columns in predictions.ranges.items():
        for model in predictions.models:
            for rival in rivals:
                if model != rival:
                    row = _compare_pair(predictions, model, rival, columns, settings)
                    rows[label, f"{model} - {rival}"] = row
    return pd.DataFrame.from_dict(rows, orient="index", dtype=object)


def _method_errors(
    predictions: Predictions, method: str, columns: Sequence[int], settings: Evaluate
) -> dict[str, Any]:
    """Return the errors of a method over some columns together, as means over the seeds."""
    quantity = predictions.quantity
    truth = predictions.truth[:, columns]
    error = predictions.predicted[method] - predictions.truth  # [S,N,R]
    square = error[..., columns] ** 2
    counted = np.isfinite(truth).any(axis=1)
    low, high = statistics.bootstrap_interval(square, truth, predictions.drive, settings) or (
        None,
        None,
    )

    # The number that is shown of an error in these columns, if there is none in the others.
    alone = np.zeros_like(error)
    alone[..., columns] = error[..., columns]
    shown = np.abs(quantity.shown(alone))
    row = {
        "nmse": statistics.nmse_of(square, truth),
        "low": low,
        "high": high,
        "seeds": [statistics.nmse_of(seed[None], truth) for seed in square],
        "mae": float(np.nanmean(shown)) if np.isfinite(shown).any() else None,
        "unit": quantity.shown_unit,
        "frames": int(counted.sum()),
        "drives": predictions.frames["drive"][counted].nunique(),
    }
    if len(columns) == 1:
        values = truth[counted, 0]
        row["mse"] = float(square[:, counted].mean()) if len(values) else None
        predicted = predictions.predicted[method][:, counted, columns[0]]
        for name in METRICS:
            row[name] = _compute_metric(name, values, predicted, quantity, columns[0])
    return row


def _compute_metric(
    name: str, truth: np.ndarray, predicted: np.ndarray, quantity: Quantity, column: int
) -> float | None:
    """Return the value of one of METRICS, or None without frames."""
    value = METRICS[name](truth, predicted, quantity, column) if len(truth) else None
    if value is not None and not math.isfinite(value):
        problem = f"metric {name} returned {value}"
        fix = "Return a finite number, or None where there is none"
        raise InputError(problem, "pipeline/evaluate/own_metrics.py", fix)
    return None if value is None else float(value)


def _mean_drift(predictions: Predictions, method: str) -> float | None:
    """Return the drift of a method, as the mean over its seeds.

    It is None for a quantity ahead of the car, since only angles at the frame itself make a path
    that can drift.
    """
    quantity = predictions.quantity
    if quantity.horizon or quantity.is_ahead:
        return None
    true_rad = quantity.angle_rad(predictions.truth)
    values = []
    for seed in predictions.predicted[method]:
        angle_rad = quantity.angle_rad(seed)
        drive = predictions.drive
        value = measure_drift(true_rad, angle_rad, drive, predictions.frames, quantity.car)
        if value is not None:
            values.append(value)
    return float(np.mean(values)) if values else None


def _compare_pair(
    predictions: Predictions, model: str, rival: str, columns: Sequence[int], settings: Evaluate
) -> dict[str, Any]:
    """Return the paired difference in nmse of a model from its rival, with a verdict."""
    truth = predictions.truth[:, columns]
    square = (predictions.predicted[model][..., columns] - truth) ** 2
    other = (predictions.predicted[rival][..., columns] - truth) ** 2
    bounds = statistics.bootstrap_interval(square, truth, predictions.drive, settings, other)
    low, high = bounds or (None, None)

    # A baseline has no seeds.
    seeds = len(square) if rival in BASELINES else min(len(square), len(other))
    part = statistics.number_parts(predictions.drive, settings.bootstrap_block_frames)
    drives = len(np.unique(part[np.isfinite(truth).any(axis=1)]))
    mean = square.mean(axis=0, keepdims=True) - other.mean(axis=0)
    return {
        "nmse": statistics.nmse_of(mean, truth),
        "low": low,
        "high": high,
        "verdict": statistics.judge_difference(bounds, seeds, drives),
    }


def to_records(table: pd.DataFrame) -> dict[str, dict[str, Any]]:
    """Return key → values of a row, for JSON. A key joins the names of the row's index by "/".

    Names that are empty and values that are missing are left out.
    """
    content = {}
    for names, row in table.iterrows():
        values = {}
        for column, value in row.items():
            if isinstance(value, list) or not pd.isna(value):
                values[column] = value
        content["/".join(name for name in names if name)] = values
    return content
