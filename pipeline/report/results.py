"""Load the outputs of stage evaluate of all models: one table of metrics and one of predictions.

All report outputs are made from these.
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from itertools import groupby
from operator import itemgetter
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from pipeline.base import store
from pipeline.base.errors import InputError, error_context
from pipeline.base.params import SPLITS
from pipeline.evaluate.schema import Metrics, Structure, Structures
from pipeline.report import paper

SHOWN_DRIVES = 6
"""Test drives that the page and Figure 4 draw one by one; the tables have all."""
_BASELINES = ("zero", "train_mean", "persistence", "odometry", "regression", "odometry_lidar")
_TYPES = {
    "drive": str, "frame": int, "time_s": float, "speed_mps": float, "steering_rad": float, "predicted_rad": float,
    "valid": int, "onset": int, "odometry_rad": float, "sigma_rad": float,
}  # fmt: skip


class Results(NamedTuple):
    """The two tables."""

    metrics: pd.DataFrame
    """One row per model, and per horizon one row per baseline (column `baseline`). Columns are the keys of metrics.json
    joined by dots, as test.by_drive.DRIVE.nmse or test.by_curvature.RANGE.rmse_deg; and paper.train_mse, …test_mse.
    Rows by horizon: the paper's networks in its order, other models in the order given, baselines."""
    predictions: pd.DataFrame
    """One row per model, run (empty for the first seed), drive and frame: the columns of predictions.csv, elapsed_s
    since the drive's first frame, and in degrees driven_deg (NaN where invalid), predicted_deg, odometry_deg,
    sigma_deg."""

    @property
    def models(self) -> pd.DataFrame:
        """Return the metrics of models, without baselines."""
        return self.metrics[~self.metrics["baseline"].astype(bool)]

    def first_seed(self, models: Sequence[str]) -> pd.DataFrame:
        """Return the predictions of the first seed of `models`."""
        return self.predictions[self.predictions["model"].isin(models) & (self.predictions["run"] == "")]

    def worst_drives(self, models: pd.DataFrame) -> pd.DataFrame:
        """Return :meth:`first_seed` of `models` for the SHOWN_DRIVES on which the best model has most squared error."""
        predictions = self.first_seed([*models["model"]])
        best = predictions[predictions["model"] == models.sort_values("test.nmse", kind="stable").iloc[0]["model"]]
        error = ((best["predicted_deg"] - best["driven_deg"]) ** 2).groupby(best["drive"]).sum()
        return predictions[predictions["drive"].isin(error.nlargest(SHOWN_DRIVES).index)]


def load_results(evaluate: Path, models: Sequence[str]) -> Results:
    """Load the results of `models` from their folders below `evaluate`. Raises InputError if a file is damaged."""
    loaded = sorted((_load_metrics(evaluate / model) for model in models), key=itemgetter("line.horizon", "paper.rank"))
    rows: list[dict[str, Any]] = []
    for _, models_of_horizon in groupby(loaded, key=itemgetter("line.horizon")):
        group = [*models_of_horizon]
        rows += [*group, *_baselines(group)]
    # dtype=object keeps integers and None as they are, also in columns that baselines lack.
    metrics = pd.DataFrame(rows, columns=None if rows else ["model", "baseline"], dtype=object)
    folders = [evaluate / model for model in models]
    tables = [_load_predictions(path, folder) for folder in folders for path in sorted(folder.rglob("predictions.csv"))]
    predictions = pd.concat(tables, ignore_index=True) if tables else pd.DataFrame(columns=["model", "run", *_TYPES])
    return Results(metrics, predictions)


def steering_lines(predictions: pd.DataFrame) -> dict[str, pd.DataFrame]:
    """Return the lines of a drive's plot over time: name → rows with elapsed_s, frame, deg, and sigma_deg of models.

    The names are driven, odometry if it was measured, and the models.
    """
    truth = predictions.drop_duplicates("frame").sort_values("frame")
    lines = {name: truth.assign(deg=truth[f"{name}_deg"]) for name in ("driven", "odometry")}
    models = {name: rows.assign(deg=rows["predicted_deg"]) for name, rows in predictions.groupby("model", sort=False)}
    return {name: rows for name, rows in (lines | models).items() if rows["deg"].notna().any()}


def columns_below(metrics: Iterable[str], prefix: str, name: str) -> dict[str, str]:
    """Return key → column for the columns ``<prefix>.<key>.<name>``: a key is a test drive or a range of curvature."""
    matches = {column: re.fullmatch(rf"{prefix}\.(.+)\.{name}", column) for column in metrics}
    return {match[1]: column for column, match in matches.items() if match and ".baselines." not in match[1]}


def _load_metrics(folder: Path) -> dict[str, Any]:
    """Return the row of a model's metrics.json."""
    path = folder / "metrics.json"
    content = Metrics(**store.read_json(path, stage=f"evaluate@{folder.name}", form=Metrics)).model_dump()
    if content["model"] != folder.name:
        raise InputError(f"expected model {folder.name}, got {content['model']}", path, fix(folder.name))
    for scores in filter(None, (content[split] for split in SPLITS)):
        for part in (scores, *scores["by_curvature"]):
            part["nmse_low"], part["nmse_high"] = part["nmse_ci95"] or (None, None)
        scores["by_curvature"] = {
            _range(part): {"baselines": {"zero": part.pop("zero") or {}}, **part} for part in scores["by_curvature"]
        }
    content["variant"]["k"] = content["variant"]["k"] or None  # 0: points without edges, so no graph is drawn
    network = paper.name(content["line"] | {"accumulate": content["variant"]["accumulate"]})
    row: dict[str, Any] = pd.json_normalize(content).astype(object).to_dict("records")[0]
    published = paper.PAPER[network] if network else None
    return row | {
        "seeds": len(row["seeds"]),
        "paper.rank": [*paper.PAPER, None].index(network),
        "paper.train_mse": published and published.train_mse,
        "paper.test_mse": published and published.test_mse,
        "baseline": False,
    }


def load_structures(folder: Path) -> dict[str, Structure]:
    """Load the graphs in a model's structure.json: drive → graph; none if there is no file."""
    path = folder / "structure.json"
    if not path.is_file():
        return {}
    return Structures(store.read_json(path, stage=f"evaluate@{folder.name}", form=Structures)).root


def _range(part: Mapping[str, Any]) -> str:
    """Return the range of |curvature| of an entry of `by_curvature`."""
    return f"≥ {part['from_1pm']:g}" if part["to_1pm"] is None else f"{part['from_1pm']:g} to {part['to_1pm']:g}"


def _baselines(rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Return a row per baseline of models with one horizon, on the frames of the first model that has it."""
    baselines = []
    for name in _BASELINES:
        key = f".baselines.{name}."
        if first := next((row for row in rows if f"test{key}nmse" in row), None):
            errors = {column.replace(key, "."): value for column, value in first.items() if key in column}
            baselines.append({"model": name, "line.horizon": first["line.horizon"], **errors, "baseline": True})
    return baselines


def _load_predictions(path: Path, folder: Path) -> pd.DataFrame:
    """Load a predictions.csv in the model's `folder` as rows of :attr:`Results.predictions`."""
    with error_context(path, fix=fix(folder.name)):
        table = pd.read_csv(path, dtype=_TYPES, keep_default_na=False, na_values=[""])
        table["sigma_rad"] = table.get("sigma_rad", np.nan)  # of models with uncertainty
        table = table[[*_TYPES]]
        if table.duplicated(["drive", "frame"]).any() or np.isinf(table.select_dtypes(float)).any(axis=None):
            raise ValueError("expected finite numbers, and one row per drive and frame")
    table.insert(0, "model", folder.name)
    table.insert(1, "run", ".".join(path.parent.relative_to(folder).parts))
    table["elapsed_s"] = table["time_s"] - table.groupby("drive")["time_s"].transform("first")
    rad = {"driven": table["steering_rad"].where(table["valid"] == 1)}
    rad |= {name: table[f"{name}_rad"] for name in ("predicted", "odometry", "sigma")}
    return table.assign(**{f"{name}_deg": np.rad2deg(angles) for name, angles in rad.items()})


def fix(model: str) -> str:
    """Return how to recreate a model's damaged results."""
    return f"Recreate it: dvc repro --force --single-item evaluate@{model}"
