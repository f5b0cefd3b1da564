"""Load the outputs of stage evaluate as groups of models that predict the same quantities."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from pipeline.base import store
from pipeline.report import paper
from pipeline.train.quantity import Quantity, load_quantity

# Names of the baselines that use neither a network nor the truth → what they predict.
NO_LEARNING = {
    "zero": "always straight ahead",
    "train_mean": "always the mean of the training drives",
    "odometry": "the present motion, measured from images",
    "regression": "a multiple of the present motion, measured from images",
}
# Names of all baselines. persistence repeats true angles, which no model gets.
BASELINES = (*NO_LEARNING, "persistence")
# A model's metrics.json with a further key, `paper`: the paper's network of this name with the same
# settings, or None.
Row = dict[str, Any]


@dataclass(frozen=True)
class Group:
    """Models that predict the same quantity equally far ahead, and the N frames of their drives.

    A frame counts if it has a valid true value, and if every model and seed predicts it. The true
    values of other frames are NaN. S is the number of a model's seeds, and R that of the columns.
    """

    key: str  # name in keys and file names, for instance angle-0, angle-10 or path-0
    quantity: Quantity
    models: dict[str, Row]  # those of the paper first, in its order
    # Rows of each model's first seed in predictions.csv, with further columns: elapsed_s, the time
    # since the drive's first frame; shown_true, shown_predicted and shown_odometry, the number that
    # charts show of each frame; and cost, the squared error of this number.
    first_seeds: pd.DataFrame
    drive: np.ndarray  # number [N] of each frame's drive, in time order
    truth: np.ndarray  # true values [N,R]
    # Model or baseline → predictions [S,N,R]. If several models have a baseline, it is that of the
    # first model.
    predicted: dict[str, np.ndarray]

    def first_seed(self, model: str) -> pd.DataFrame:
        """Return the predictions of the first seed of a model."""
        return self.first_seeds[self.first_seeds["model"] == model]

    def typical_drives(self, model: str) -> dict[str, str]:
        """Return drive → rank, for the best, the median and the worst drive by a model's error."""
        costs = self.first_seed(model).groupby("drive")["cost"].mean().dropna()
        drives = costs.sort_values(kind="stable").index
        if not len(drives):
            return {}
        if len(drives) == 1:
            return {drives[0]: "only"}
        # Of two drives, the second has the rank of the worst.
        ranks = {0: "best", len(drives) // 2: "median", len(drives) - 1: "worst"}
        return {drives[number]: rank for number, rank in ranks.items()}


def load_groups(folders: Mapping[str, Path]) -> list[Group]:
    """Load the results of models. `folders` is model → its folder of stage evaluate.

    Raises InputError if a file is missing.
    """
    rows: dict[str, Row] = {}
    for model, folder in folders.items():
        row = store.read_json(folder / "metrics.json", stage=f"evaluate@{folder.name}")
        rows[model] = row | {"paper": paper.find(model, row["entry"], row["variant"])}

    # Networks of the paper come first, in the order of its Table 2. Other models have None.
    order = [*paper.PAPER.values(), None]
    ranked = sorted(rows, key=lambda model: order.index(rows[model]["paper"]))
    groups: dict[tuple[str, int], dict[str, Row]] = {}
    for model in ranked:
        entry = rows[model]["entry"]
        groups.setdefault((entry["predict"], entry["horizon"]), {})[model] = rows[model]

    # What lies ahead comes first, since the present angle can also be measured.
    ordered = sorted(groups, key=lambda group: (not load_quantity(group[0]).is_ahead, group))
    loaded = []
    for predict, horizon in ordered:
        models = groups[predict, horizon]
        tables = {
            model: pd.read_csv(folders[model] / "predictions.csv", dtype={"drive": str})
            for model in models
        }
        section = next(iter(models.values()))["labels"]
        quantity = load_quantity(predict)(section, horizon)
        loaded.append(_load_group(f"{predict}-{horizon}", quantity, models, tables))
    return loaded


def _load_group(
    key: str, quantity: Quantity, models: dict[str, Row], tables: Mapping[str, pd.DataFrame]
) -> Group:
    """Return the group of some models. `tables` is model → its predictions.csv."""
    columns = quantity.columns
    firsts = []
    for table in tables.values():
        first_seed = table[table["seed"] == table["seed"].iloc[0]]
        firsts.append(_with_shown(first_seed, quantity))
    first_seeds = pd.concat(firsts, ignore_index=True)

    # List the drives and frames of all models. If models share a frame, its values are those of the
    # first model that has them.
    indexed = {model: table.set_index(["drive", "frame"]) for model, table in tables.items()}
    frames = pd.concat(indexed.values()).groupby(level=[0, 1]).first()

    def values(table: pd.DataFrame, kind: str) -> np.ndarray:
        names = [f"{kind}_{column}" for column in columns]
        return table.reindex(frames.index).reindex(columns=names).to_numpy(float)

    predicted = {}
    common = np.ones((len(frames), len(columns)), bool)
    for model, table in indexed.items():
        seeds = [values(of_seed, "predicted") for _, of_seed in table.groupby("seed", sort=False)]
        predicted[model] = np.stack(seeds)
        common &= np.isfinite(predicted[model]).all(axis=0)
    truth = np.where(common, values(frames, "true"), np.nan)

    # The first baseline, zero, is not in predictions.csv.
    baselines = {"zero": np.zeros_like(truth)}
    for name in BASELINES[1:]:
        baselines[name] = values(frames, name)

    # Before the first measurement, odometry is 0, as in the regression.
    before = np.isnan(baselines["odometry"]) & np.isfinite(baselines["regression"])
    baselines["odometry"] = np.where(before, 0.0, baselines["odometry"])

    # A baseline is used if it has a value wherever the truth has one.
    for name, value in baselines.items():
        if np.isfinite(value[np.isfinite(truth)]).all():
            predicted[name] = value[None]
    drive, _ = frames.index.get_level_values("drive").factorize()
    return Group(key, quantity, models, first_seeds, drive, truth, predicted)


def _with_shown(table: pd.DataFrame, quantity: Quantity) -> pd.DataFrame:
    """Return the predictions of a seed with the further columns of :attr:`Group.first_seeds`."""
    table = table.copy()
    for kind in ("true", "predicted", "odometry"):
        names = [f"{kind}_{column}" for column in quantity.columns]
        values = table.reindex(columns=names).to_numpy(float)
        table[f"shown_{kind}"] = quantity.shown(values)
    table["elapsed_s"] = table["time_s"] - table.groupby("drive")["time_s"].transform("first")
    table["cost"] = (table["shown_predicted"] - table["shown_true"]) ** 2
    return table
