"""Load the outputs of stage evaluate: groups of models that predict the same quantities, each with its baselines.

All report outputs are made from these groups.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from pipeline.base import store
from pipeline.base.params import SPLITS
from pipeline.report import paper

SHOWN_DRIVES = 6  # test drives that the page draws one by one; the tables have all
_LEARNING = ["epoch", "train_loss", "val_nmse"]
BASELINES = ("zero", "train_mean", "persistence", "odometry", "regression")
Row = dict[str, Any]
"""A model's metrics.json with ``paper`` (its :class:`paper.Published` or None) and ``baseline`` False; or a baseline
with ``model``, ``baseline`` True and the scores of each split."""


@dataclass(frozen=True)
class Group:
    """Models that predict the same columns equally far ahead, and their baselines."""

    key: str  # part of file names: angle-0, angle-10 or path-0
    title: str
    labels: dict[str, str]  # column → label: empty for the steering angle, "5-10 m" for a range of the path ahead
    models: list[Row]  # in the order of the paper, then as given
    # predictions.csv of all models and seeds, with columns model, run (empty for the first seed), elapsed_s since the
    # drive's first frame, and in degrees, left +, true_deg, predicted_deg, odometry_deg and sigma_deg: of the steering
    # angle, or of the turn in all ranges of the path together (then without sigma).
    predictions: pd.DataFrame

    @property
    def rows(self) -> list[Row]:
        """Return the models and the baselines, on the frames of the first model that has them."""
        rows = [*self.models]
        for name in BASELINES:
            has = [row for row in self.models if all(name in scores["baselines"] for scores in row["test"].values())]
            rows += [_baseline(name, has[0])] if has else []
        return rows

    @property
    def by_error(self) -> list[Row]:
        """Return the models by :func:`mean_nmse`, the best first."""
        return sorted(self.models, key=mean_nmse)

    def first_seed(self, model: str) -> pd.DataFrame:
        """Return the predictions of the first seed of a model."""
        return self.predictions[(self.predictions["model"] == model) & (self.predictions["run"] == "")]

    def worst_drives(self) -> list[str]:
        """Return the SHOWN_DRIVES test drives on which the best model has most squared error, in the CSV's order."""
        best = self.first_seed(self.by_error[0]["model"])
        error = ((best["predicted_deg"] - best["true_deg"]) ** 2).groupby(best["drive"], sort=False).sum()
        return [drive for drive in error.index if drive in error.nlargest(SHOWN_DRIVES).index]


def mean_nmse(row: Row) -> float:
    """Return the mean test nmse of all columns of a row; infinite if none has one."""
    known = [scores["nmse"] for scores in row["test"].values() if scores["nmse"] is not None]
    return float(np.mean(known)) if known else np.inf


def load_groups(evaluate: Path, models: Sequence[str]) -> list[Group]:
    """Load the results of `models` from their folders below `evaluate`. Raises InputError if a file is missing."""
    loaded: dict[tuple[str, int], list[Row]] = {}
    for model in models:
        row = store.read_json(evaluate / model / "metrics.json", stage=f"evaluate@{model}")
        settings = row["entry"] | {"accumulate": row["variant"].get("accumulate")}
        row |= {"baseline": False, "paper": paper.find(settings)}
        loaded.setdefault((row["entry"]["predict"], row["entry"]["horizon"]), []).append(row)
    order = [*paper.PAPER.values(), None]
    groups = []
    for (predict, horizon), rows in sorted(loaded.items()):
        title = "steering angle" if predict == "angle" else "path ahead"
        title += f", {horizon} frames ahead" if horizon else ""
        columns, ranked = rows[0]["columns"], sorted(rows, key=lambda row: order.index(row["paper"]))
        labels = {
            name: "" if column["to_m"] is None else f"{column['from_m']:g}-{column['to_m']:g} m"
            for name, column in columns.items()
        }
        predictions = pd.concat([_load_predictions(evaluate / row["model"], columns) for row in ranked])
        groups.append(Group(f"{predict}-{horizon}", title, labels, ranked, predictions.reset_index(drop=True)))
    return groups


def _load_predictions(folder: Path, columns: Row) -> pd.DataFrame:
    """Load predictions.csv of all seeds in a model's folder as rows of :attr:`Group.predictions`."""
    length_m = {name: 1 if part["to_m"] is None else part["to_m"] - part["from_m"] for name, part in columns.items()}
    tables = []
    for path in sorted(folder.rglob("predictions.csv")):
        table = pd.read_csv(path, dtype={"drive": str})
        for kind in ("true", "predicted", "odometry", "sigma"):
            known = kind != "sigma" or len(columns) == 1
            values = [table.get(f"{kind}_{name}", np.nan) * length for name, length in length_m.items()]
            table[f"{kind}_deg"] = np.rad2deg(sum(values)) if known else np.nan
        elapsed_s = table["time_s"] - table.groupby("drive")["time_s"].transform("first")
        run = ".".join(path.parent.relative_to(folder).parts)
        tables.append(table.assign(model=folder.name, run=run, elapsed_s=elapsed_s))
    return pd.concat(tables, ignore_index=True)


def _baseline(name: str, model: Row) -> Row:
    """Return the row of a baseline, from the scores that stand beside a model's."""
    row: Row = {"model": name, "baseline": True, "columns": model["columns"]}
    for split in SPLITS:
        row[split] = model[split] and {column: scores["baselines"][name] for column, scores in model[split].items()}
    for column, scores in row["test"].items():
        others = model["test"][column]["without_decisions"]["baselines"]
        row["test"][column] = scores | {"without_decisions": others.get(name)}
    return row


def flat_metrics(groups: Sequence[Group]) -> dict[str, float]:
    """Return all metrics under flat names, for `dvc metrics`; values that do not exist are left out.

    - ``<model>.nmse`` and its 95 % interval ``nmse_low`` to ``nmse_high``; of a range of the path ahead
      ``<model>.nmse_5-10m`` and so on; names of the other splits start with ``train_`` or ``val_``
    - ``odometry-angle-<horizon>`` and ``odometry-path-<horizon>``: the same of odometry
    """
    values: dict[str, Any] = {}
    for group in groups:
        named = {row["model"]: row for row in group.models}
        named |= {f"odometry-{group.key}": row for row in group.rows if row["model"] == "odometry"}
        for name, row in named.items():
            for column, label in group.labels.items():
                nmse, test = f"nmse_{label}".strip("_").replace(" ", ""), row["test"][column]
                low, high = test.get("nmse_ci95") or (None, None)
                values |= {f"{name}.{nmse}": test["nmse"], f"{name}.{nmse}_low": low, f"{name}.{nmse}_high": high}
                for split in ("train", "val"):
                    values[f"{name}.{split}_{nmse}"] = row[split] and row[split][column]["nmse"]
    return {name: value for name, value in values.items() if value is not None}


def load_curves(train: Path, models: Sequence[str]) -> dict[str, pd.DataFrame]:
    """Load the learning curves of `models` from their folders below `train`: network → epoch, train_loss, val_nmse.

    A network is named as its folder: ``<model>``, ``<model>.seed-<n>``, ``<model>.seed-<n>.fold-<drive>``. Numbers stay
    text, as written.
    """
    paths = [path for model in models for path in sorted((train / model).rglob("curve.csv"))]
    return {
        ".".join(path.relative_to(train).parts[:-1]): pd.read_csv(path, usecols=_LEARNING, dtype=str)[_LEARNING]
        for path in paths
    }
