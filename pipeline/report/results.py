"""Load the outputs of stage evaluate: groups of models that predict the same quantities, each with
its baselines.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from pipeline.base import store
from pipeline.evaluate import statistics
from pipeline.evaluate.settings import Evaluate
from pipeline.report import paper

NO_LEARNING = {  # baseline → what it predicts
    "zero": "always straight ahead",
    "train_mean": "always the mean of the training drives",
    "odometry": "the present motion, measured from images",
    "regression": "a multiple of the present motion, measured from images",
}
BASELINES = (*NO_LEARNING, "persistence")  # persistence repeats true angles, which no model gets
USELESS = 0.95  # nmse on the test drives above which a model has learned nothing
# A model's metrics.json with `paper`, its :class:`paper.Published` or None, and `val_nmse`, its
# nmse on the validation drives, mean over its columns, inf if it is unknown.
Row = dict[str, Any]
# a value, None if unknown, and its :func:`statistics.interval`
Estimate = tuple[float | None, list[float] | None]
Difference = tuple[
    float | None, list[float] | None, str
]  # the same of a difference, and its :func:`statistics.verdict`


@dataclass(frozen=True)
class Group:
    """Models that predict the same R columns equally far ahead, their baselines, and the N frames
    of their drives.

    Only the frames with a valid truth that every model and seed predicts count: the truth of the
    others is NaN.
    """

    key: str  # part of file names: angle-0, angle-10 or path-0
    title: str
    # column → label: empty for the steering angle, "5-10 m" for a range of the path ahead
    labels: dict[str, str]
    # column → length of the range, by which its curvature makes a turn; 1 for the angle
    length_m: dict[str, float]
    models: list[Row]  # in the order of the paper, then as given
    # predictions.csv of each model's first seed, with columns elapsed_s since the drive's first
    # frame, and cost, the squared error; in degrees, left +, true_deg, predicted_deg and
    # odometry_deg: of the steering angle, or of the turn in all ranges of the path together.
    predictions: pd.DataFrame
    settings: Evaluate
    drive: np.ndarray  # [N] numbers, in time order
    truth: np.ndarray  # [N,R]
    # model or baseline → [S,N,R]; a baseline is of the first model that has it
    predicted: dict[str, np.ndarray]

    def nmse(self, name: str, minus: str | None = None, column: str | None = None) -> Estimate:
        """Return the nmse of a model or baseline, mean over seeds; with `minus` the paired
        difference from another.

        Of one column, or the mean of all that are not 0 everywhere.
        """
        truth = self.truth[:, self._columns(column)]
        error = self._squared_error(name, column)
        if minus is None:
            return _nmse(error.mean(axis=0), truth), statistics.interval(
                error, truth, self.drive, self.settings
            )
        other = self._squared_error(minus, column)
        value = _nmse(error.mean(axis=0) - other.mean(axis=0), truth)
        return value, statistics.interval(error, truth, self.drive, self.settings, other)

    def _squared_error(self, name: str, column: str | None) -> np.ndarray:
        """Return the squared errors [S,N,R] of a model or baseline, in one column or all."""
        columns = self._columns(column)
        return np.square(self.predicted[name][..., columns] - self.truth[:, columns])

    def difference(self, name: str, minus: str, column: str | None = None) -> Difference:
        """Return the paired difference in nmse of a model from another or a baseline."""
        value, bounds = self.nmse(name, minus, column)
        seeds = min(len(self.predicted[of]) for of in (name, minus) if of not in BASELINES)
        part = statistics.parts(self.drive, self.settings.bootstrap_block_frames)
        counted = np.isfinite(self.truth[:, self._columns(column)]).any(axis=1)
        return value, bounds, statistics.verdict(bounds, seeds, len(np.unique(part[counted])))

    def column_of(self, label: str) -> str | None:
        """Return the column with a label; of a path, None without one: all ranges together."""
        return next(
            (column for column, of_column in self.labels.items() if of_column == label), None
        )

    def _columns(self, column: str | None) -> list[int]:
        return [*range(len(self.labels))] if column is None else [[*self.labels].index(column)]

    def scores(self, name: str, column: str) -> dict[str, Any]:
        """Return the :func:`statistics.scores` of a model or baseline, and the nmse of each seed as
        `by_seed`.
        """
        number = [*self.labels].index(column)
        rows = np.isfinite(self.truth[:, number])
        truth, predicted = self.truth[rows, number], self.predicted[name][:, rows, number]
        by_seed = [statistics.scores(truth, seed)["nmse"] for seed in predicted]
        return statistics.scores(truth, predicted) | {"by_seed": by_seed}

    def mae_deg(self, name: str) -> float:
        """Return the mean absolute error in degrees, of the angle or of the turn in all ranges
        together.
        """
        turn_rad = ((self.predicted[name] - self.truth) * [*self.length_m.values()]).sum(axis=-1)
        known = np.abs(turn_rad[np.isfinite(turn_rad)])
        return float(np.degrees(known.mean())) if len(known) else np.nan

    @cached_property
    def by_error(self) -> list[Row]:
        """The models by validation error, the least first; by test error if a model has no
        validation error.
        """
        return sorted(
            self.models,
            key=lambda row: row["val_nmse"] if self.validated else self._rank(row["model"]),
        )

    @property
    def validated(self) -> bool:
        """Whether all models have a validation error."""
        return all(row["val_nmse"] < np.inf for row in self.models)

    @property
    def best_baseline(self) -> str:
        """The baseline without learning that has the least nmse; zero among equals."""
        return min((name for name in NO_LEARNING if name in self.predicted), key=self._rank)

    def _rank(self, name: str) -> float:
        value = _nmse(self._squared_error(name, None).mean(axis=0), self.truth)
        return np.inf if value is None else value

    @property
    def typical_drives(self) -> dict[str, str]:
        """The drives with the least, the median and the largest mean squared error of the best
        model → their rank.
        """
        costs = self.first_seed(self.by_error[0]["model"]).groupby("drive")["cost"].mean().dropna()
        drives = costs.sort_values(kind="stable").index
        ranks = {
            0: "best",
            len(drives) // 2: "median",
            len(drives) - 1: "worst" if len(drives) > 1 else "only",
        }
        return {drives[number]: rank for number, rank in ranks.items()} if len(drives) else {}

    def first_seed(self, model: str) -> pd.DataFrame:
        """Return the predictions of the first seed of a model."""
        return self.predictions[self.predictions["model"] == model]


def _nmse(error: np.ndarray, truth: np.ndarray) -> float | None:
    """Return Σ error / Σ truth² of arrays [N,R], the mean over columns; None if every true value is
    0.
    """
    zero = np.nansum(truth**2, axis=0)
    bends = zero > 0
    return float((np.nansum(error, axis=0)[bends] / zero[bends]).mean()) if bends.any() else None


def load_groups(folders: Mapping[str, Path], settings: Evaluate) -> list[Group]:
    """Load the results of models, name → folder of stage evaluate. Raises InputError if a file is
    missing.
    """
    loaded: dict[tuple[str, int], list[Row]] = {}
    for model, folder in folders.items():
        row = store.read_json(folder / "metrics.json", stage=f"evaluate@{folder.name}") | {
            "model": model
        }
        row["paper"] = paper.find(model, row["entry"], row["variant"])
        known = [
            scores["nmse"] for scores in (row["val"] or {}).values() if scores["nmse"] is not None
        ]
        row["val_nmse"] = float(np.mean(known)) if known else np.inf
        loaded.setdefault((row["entry"]["predict"], row["entry"]["horizon"]), []).append(row)
    order = [*paper.PAPER.values(), None]
    groups = []
    for (predict, horizon), rows in sorted(loaded.items()):
        title = "path ahead" if predict == "path" else "steering angle"
        title += f", {horizon} frames ahead" if horizon else ""
        columns, ranked = (
            rows[0]["columns"],
            sorted(rows, key=lambda row: order.index(row["paper"])),
        )
        ranges = {name: (column["from_m"], column["to_m"]) for name, column in columns.items()}
        labels = {
            name: "" if far is None else f"{near:g}-{far:g} m"
            for name, (near, far) in ranges.items()
        }
        length_m = {
            name: 1.0 if far is None else far - near for name, (near, far) in ranges.items()
        }
        models = [row["model"] for row in ranked]
        tables = {name: _load_predictions(folders[name], name, length_m) for name in models}
        predictions = pd.concat(tables.values(), ignore_index=True)
        aligned = _align(predictions, models, [*columns])
        firsts = [table[table["seed"] == table["seed"].iloc[0]] for table in tables.values()]
        first = pd.concat(firsts, ignore_index=True)
        groups.append(
            Group(
                f"{predict}-{horizon}", title, labels, length_m, ranked, first, settings, **aligned
            )
        )
    return groups


def _align(
    predictions: pd.DataFrame, models: Sequence[str], columns: Sequence[str]
) -> dict[str, Any]:
    """Return the arrays of a :class:`Group`."""
    rows = predictions.set_index(["drive", "frame"])
    first = rows.groupby(level=[0, 1]).first()  # of each value the first model's that has it

    def values(table: pd.DataFrame, kind: str) -> np.ndarray:
        return (
            table.reindex(first.index)
            .reindex(columns=[f"{kind}_{name}" for name in columns])
            .to_numpy(float)
        )

    predicted = {
        model: np.stack(
            [
                values(of_seed, "predicted")
                for _, of_seed in rows[rows["model"] == model].groupby("seed", sort=False)
            ]
        )
        for model in models
    }
    common = np.all([np.isfinite(seeds).all(axis=0) for seeds in predicted.values()], axis=0)
    truth = np.where(common, values(first, "true"), np.nan)
    baselines = {"zero": np.zeros_like(truth)} | {
        name: values(first, name) for name in BASELINES[1:]
    }
    # the first measurement
    before = np.isnan(baselines["odometry"]) & np.isfinite(baselines["regression"])
    baselines["odometry"] = np.where(before, 0.0, baselines["odometry"])
    known = np.isfinite(truth)
    return {
        "drive": first.index.get_level_values("drive").factorize()[0],
        "truth": truth,
        "predicted": predicted
        | {name: of[None] for name, of in baselines.items() if np.isfinite(of[known]).all()},
    }


def _load_predictions(folder: Path, model: str, length_m: Mapping[str, float]) -> pd.DataFrame:
    """Load a model's predictions.csv, with the columns of :class:`Group`."""
    table = pd.read_csv(folder / "predictions.csv", dtype={"drive": str})
    for kind in ("true", "predicted", "odometry"):
        turns_rad = [
            table.get(f"{kind}_{name}", np.nan) * length for name, length in length_m.items()
        ]
        table[f"{kind}_deg"] = np.rad2deg(sum(turns_rad))
    elapsed_s = table["time_s"] - table.groupby("drive")["time_s"].transform("first")
    cost = (table["predicted_deg"] - table["true_deg"]) ** 2
    return table.assign(model=model, elapsed_s=elapsed_s, cost=cost)
