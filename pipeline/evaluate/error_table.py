"""Compute the errors of predictions, and the differences between two methods, as tables.

A method is a model or a baseline. All numbers of a table are made of :func:`frame_errors`, which
chooses the frames that count. Letters: S seeds of a model, N frames, R columns of the predicted
quantity, C columns of an error.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
import pandas as pd

from pipeline.base.errors import InputError
from pipeline.evaluate import statistics
from pipeline.evaluate.drift import measure_drift
from pipeline.evaluate.own_metrics import METRICS, Metric
from pipeline.evaluate.settings import BASELINES, MEASURED, NO_LEARNING, Evaluate
from pipeline.evaluate.statistics import FrameErrors
from pipeline.labels.label import TURNING_RAD
from pipeline.train.quantity import Quantity

# Columns of a table of errors or differences, without METRICS. A row has an nmse, or an error in
# the quantity's own measure.
COLUMNS = [
    "error",
    "nmse",
    "low",
    "high",
    "seeds",
    "mae",
    "unit",
    "mse",
    "frames",
    "drives",
    "worst_drive",
    "worst_share",
    "drift",
    "verdict",
    "parts",
]
# Columns that stage report adds to the rows of models → what they are.
FACTS = {
    "ends": "labels of the errors in the quantity's own measure, if it has any",
    "lead": "the label of the error that leads, if it is not the nmse over all columns",
    "validation": "the error that leads, on the validation drives",
    "validation_frames": "number of their frames that count",
    "scene": "whether the model gets the scene",
    "paper": "whether the model is that of the paper's name",
    "parameters": "number of weights",
    "edges": "directed kNN edges per frame after pruning, if the model reads any",
    "turning_frames": "frames of the training drives that turn",
    "untrained": "seeds that failed to train",
}


@dataclass(frozen=True)
class Predictions:
    """What methods predict of a quantity in the same N frames."""

    quantity: Quantity
    frames: pd.DataFrame  # columns drive, frame, time_s and speed_mps [N], in time order
    truth: np.ndarray  # true values [N,R], NaN in frames that do not count
    predicted: dict[str, np.ndarray]  # method → predictions [S,N,R]
    unmeasured: Sequence[str] = ()  # drives without measured motion, if others have some

    @property
    def models(self) -> list[str]:
        """The methods that are no baselines."""
        return [name for name in self.predicted if name not in BASELINES]

    @property
    def drive(self) -> np.ndarray:
        """The number [N] of each frame's drive."""
        number, _ = self.frames["drive"].factorize()
        return number

    def parts(self, settings: Evaluate) -> np.ndarray:
        """Return the number [N] of each frame's part of a drive, which the bootstrap draws."""
        time_s = self.frames["time_s"].to_numpy()
        return statistics.number_parts(self.drive, time_s, settings.bootstrap_block_s)

    @property
    def frames_text(self) -> str:
        """Which frames count, in words."""
        if len(self.models) == 1:
            return f"frames that {self.models[0]} predicts"
        return f"frames that each of {', '.join(self.models)} predicts"

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

    Before the first measurement of a drive, odometry and its regression are 0, also if nothing is
    measured in the complete drive. They are left out if nothing is measured in any drive.
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
    is_measured = np.isfinite(baselines["odometry"]).any(axis=1)
    unmeasured: list[str] = []
    if is_measured.any():
        drives = frames.index.get_level_values("drive")
        counted = np.isfinite(truth).any(axis=1)
        unmeasured = sorted({*drives[counted]} - {*drives[is_measured]})
    for name in MEASURED:
        if np.isfinite(baselines[name]).any():
            baselines[name] = np.nan_to_num(baselines[name])

    for name, value in baselines.items():
        if np.isfinite(value[np.isfinite(truth)]).all():
            predicted[name] = value[None]
    columns = ["drive", "frame", "time_s", "speed_mps"]
    return Predictions(quantity, frames.reset_index()[columns], truth, predicted, unmeasured)


def frame_errors(predictions: Predictions, method: str) -> dict[str, FrameErrors]:
    """Return label → errors of a method in the frames that count.

    A label is one of the quantity's ends, with errors in its own measure, or a range, with those of
    the nmse. The range without a name has a column for each range.
    """
    predicted = predictions.predicted[method]
    truth = predictions.truth
    errors = {}
    distance = predictions.quantity.errors(predicted, truth)  # [S,N,E]
    for number, label in enumerate(predictions.quantity.ends):
        of_end = distance[..., [number]]
        errors[label] = statistics.count_frames(of_end, np.ones(of_end.shape[1:]))
    square = (predicted - truth) ** 2
    for label, columns in predictions.ranges.items():
        errors[label] = statistics.count_frames(square[..., columns], truth[:, columns] ** 2)
    return errors


def is_turning(quantity: Quantity, values: np.ndarray) -> np.ndarray:
    """Return whether the values [F,R] of a quantity turn in any of its columns, bool [F]."""
    angle_rad = np.arctan(quantity.curvature(values) * quantity.car.wheelbase_m)
    return np.any(np.abs(angle_rad) > TURNING_RAD, axis=1)


def error_table(
    predictions: Predictions, methods: Sequence[str], settings: Evaluate
) -> pd.DataFrame:
    """Return the errors of methods, with the index (label, method)."""
    check_metrics()
    errors = {method: frame_errors(predictions, method) for method in methods}
    rows = {}
    for label in [*predictions.quantity.ends, *predictions.ranges]:
        for method in methods:
            row = _error_row(predictions, label, errors[method][label], settings)
            if label in predictions.ranges:
                row |= _column_errors(predictions, method, label, errors[method][label])
            rows[label, method] = row
    for method in methods:
        rows["", method]["drift"] = _mean_drift(predictions, method)
    return pd.DataFrame.from_dict(rows, orient="index", dtype=object)


def compare_methods(predictions: Predictions, settings: Evaluate) -> pd.DataFrame:
    """Return the paired differences of models, with the index (label, "MODEL - RIVAL").

    A rival is another model, or a baseline that does not get the truth. Two models have one
    interval, whichever is named first.
    """
    models = sorted(predictions.models)
    baselines = [name for name in NO_LEARNING if name in predictions.predicted]
    pairs = [*combinations(models, 2)]
    pairs += [(model, baseline) for model in models for baseline in baselines]
    errors = {name: frame_errors(predictions, name) for name in [*models, *baselines]}
    rows = {}
    for label in [*predictions.quantity.ends, *predictions.ranges]:
        of_label = {name: errors_of_method[label] for name, errors_of_method in errors.items()}
        for model, rival in pairs:
            row = _compare_pair(predictions, label, model, rival, of_label, settings)
            rows[label, f"{model} - {rival}"] = row
            if rival in models:
                rows[label, f"{rival} - {model}"] = _turn_round(row)
    return pd.DataFrame.from_dict(rows, orient="index", dtype=object)


def check_metrics() -> None:
    """Raise InputError if one of METRICS has the name of another column, or no units."""
    for name, metric in METRICS.items():
        if name in (*COLUMNS, *FACTS, "model"):
            problem = f"metric {name} has the name of a column of the tables"
            raise InputError(problem, "pipeline/evaluate/own_metrics.py", "Rename it")
        if not isinstance(metric, Metric) or not isinstance(metric.units, tuple):
            problem = f"metric {name} does not name its units"
            fix = f'Write METRICS["{name}"] = Metric(FUNCTION, units=("rad",))'
            raise InputError(problem, "pipeline/evaluate/own_metrics.py", fix)


def _error_row(
    predictions: Predictions, label: str, errors: FrameErrors, settings: Evaluate
) -> dict[str, Any]:
    """Return the error of a method with its interval, as the mean over the seeds."""
    counted = errors.counted.any(axis=1)
    bounds = statistics.bootstrap_interval(errors, predictions.parts(settings), settings)
    low, high = bounds or (None, None)
    seeds = [errors._replace(error=seed[None]) for seed in errors.error]
    row: dict[str, Any] = {
        _value_column(predictions, label): statistics.mean_error(errors),
        "low": low,
        "high": high,
        "seeds": [statistics.mean_error(seed) for seed in seeds],
        "unit": predictions.quantity.measure.unit if label in predictions.quantity.ends else None,
        "frames": int(counted.sum()),
        "drives": predictions.frames["drive"][counted].nunique(),
    }
    worst = statistics.find_worst(errors, predictions.drive)
    if worst is not None:
        number, row["worst_share"] = worst
        row["worst_drive"] = predictions.frames["drive"].unique()[number]
    return row


def _column_errors(
    predictions: Predictions, method: str, label: str, errors: FrameErrors
) -> dict[str, Any]:
    """Return further errors of a method in the columns of a range, with their unit."""
    quantity = predictions.quantity
    columns = predictions.ranges[label]
    counted = errors.counted.all(axis=1)
    predicted = predictions.predicted[method][:, counted]
    truth = predictions.truth[counted]

    # The number that is shown of an error in these columns, if there is none in the others.
    alone = np.zeros_like(predicted)
    alone[..., columns] = (predicted - truth)[..., columns]
    shown = np.abs(quantity.shown(alone))
    row = {"mae": float(shown.mean()) if counted.any() else None, "unit": quantity.shown_unit}
    if len(columns) == 1:
        row["mse"] = float(errors.error[:, counted].mean()) if counted.any() else None
        values = truth[:, columns[0]]
        for name, metric in METRICS.items():
            if quantity.unit in metric.units:
                row[name] = _compute_metric(
                    name, values, predicted[..., columns[0]], quantity, columns[0]
                )
    return row


def _compute_metric(
    name: str, truth: np.ndarray, predicted: np.ndarray, quantity: Quantity, column: int
) -> float | None:
    """Return the value of one of METRICS, or None without frames."""
    value = METRICS[name].compute(truth, predicted, quantity, column) if len(truth) else None
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


def _value_column(predictions: Predictions, label: str) -> str:
    """Return the column of the errors of a label."""
    return "error" if label in predictions.quantity.ends else "nmse"


def _compare_pair(
    predictions: Predictions,
    label: str,
    model: str,
    rival: str,
    errors: Mapping[str, FrameErrors],
    settings: Evaluate,
) -> dict[str, Any]:
    """Return the paired difference of a model from its rival.

    If its label leads, it has a verdict, and the number of parts of drives that this is read from.
    `errors` is method → errors of the label.
    """
    first = errors[model]
    second = errors[rival]
    part = predictions.parts(settings)
    bounds = statistics.bootstrap_interval(first, part, settings, second)
    low, high = bounds or (None, None)
    mean = first.error.mean(axis=0, keepdims=True) - second.error.mean(axis=0)
    difference = statistics.mean_error(first._replace(error=mean))
    column = _value_column(predictions, label)
    row: dict[str, Any] = {column: difference, "low": low, "high": high}
    quantity = predictions.quantity
    if label == quantity.lead:
        # A baseline has no seeds.
        seeds = len(first.error)
        if rival not in BASELINES:
            seeds = min(seeds, len(second.error))
        parts = len(np.unique(part[first.counted.any(axis=1)]))
        digits = quantity.measure.digits
        row["verdict"] = statistics.judge_difference(bounds, seeds, parts, digits)
        row["parts"] = parts
    return row


def _turn_round(row: Mapping[str, Any]) -> dict[str, Any]:
    """Return the difference of B from A, from a row with that of A from B."""
    opposite = {column: -value for column, value in row.items() if isinstance(value, float)}
    turned = {**row, **opposite, "low": opposite.get("high"), "high": opposite.get("low")}
    if "verdict" in row:
        verdicts = {"better": "worse", "worse": "better"}
        turned["verdict"] = verdicts.get(row["verdict"], row["verdict"])
    return turned


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
