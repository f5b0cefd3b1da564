"""Compare models that predict the path ahead: tables by range, with paired differences, and DVC's metrics."""

from collections.abc import Callable, Sequence
from itertools import chain
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd

from pipeline.base import store
from pipeline.base.errors import error_context
from pipeline.evaluate.errors import interval, interval_text
from pipeline.evaluate.schema import PathMetrics, Range, RangeErrors
from pipeline.report.results import fix
from pipeline.report.tables import NONE, Table
from pipeline.settings.evaluate import Evaluate

_NOTE = (
    "nmse of the mean curvature of the driven path, by distance ahead; zero is the straight path. held repeats the "
    "present measured curvature; regression multiplies it by its regression coefficient on the training drives. In "
    "parentheses: 95 % interval for other roads."
)
_WITHOUT = "Without frames whose path reaches the onset of a turn, where the driver's choice is unknown."
_WITHIN = "Share of the frames whose path is within ±σ of the prediction; 68 % on the validation drives."
_DIFFERENCES = (
    "nmse of the first model minus that of the second on the same frames, mean over the seeds, with its 95 % interval: "
    "below 0, the first is better."
)


class Difference(NamedTuple):
    """Difference in nmse of two models, NaN without common frames or bends, and its 95 % interval, or NaN."""

    nmse: float
    low: float
    high: float


class PathResults(NamedTuple):
    """Results of a model that predicts the path ahead."""

    metrics: PathMetrics
    predictions: pd.DataFrame
    """Rows of predictions.csv of each seed, with model, run, elapsed_s, and the angles driven_deg and predicted_deg by
    which the path turns in all ranges together; NaN without one of them."""

    @property
    def ahead_m(self) -> list[float]:
        """Return the edges of the ranges."""
        return [self.metrics.test[0].from_m, *(row.to_m for row in self.metrics.test)]

    @property
    def mean_nmse(self) -> float:
        """Return the mean over the ranges; infinite if none has a bend."""
        known = [row.nmse for row in self.metrics.test if row.nmse is not None]
        return float(np.mean(known)) if known else np.inf

    def curvature_1pm(self, row: pd.Series, kind: str) -> list[float]:
        """Return the driven or predicted path [R] of a row of `predictions`."""
        return [float(row[f"{kind}_{_name(errors)}_1pm"]) for errors in self.metrics.test]


def path_models(evaluate: Path, models: Sequence[str]) -> list[str]:
    """Return those of the evaluated `models` that predict the path ahead."""
    files = {model: evaluate / model / "metrics.json" for model in models}
    lines = {model: store.read_json(path, stage=f"evaluate@{model}").get("line") for model, path in files.items()}
    return [model for model, line in lines.items() if isinstance(line, dict) and line.get("predict") == "path"]


def load_paths(evaluate: Path, models: Sequence[str]) -> list[PathResults]:
    """Load the results of `models` from their folders below `evaluate`. Raises InputError if a file is damaged."""
    return [_load(evaluate / model) for model in models]


def _load(folder: Path) -> PathResults:
    stage = f"evaluate@{folder.name}"
    metrics = PathMetrics(**store.read_json(folder / "metrics.json", stage=stage, form=PathMetrics))
    runs = []
    for path in sorted(folder.rglob("predictions.csv")):
        with error_context(path, fix=fix(folder.name)):
            columns = {kind: [f"{kind}_{_name(row)}_1pm" for row in metrics.test] for kind in ("driven", "predicted")}
            types = {"drive": str, "frame": int, **dict.fromkeys(["time_s", *chain(*columns.values())], float)}
            table = pd.read_csv(path, usecols=[*types], dtype=types)
            table["elapsed_s"] = table["time_s"] - table.groupby("drive")["time_s"].transform("first")
            for kind, names in columns.items():
                turned_rad = table[names].to_numpy() @ [row.to_m - row.from_m for row in metrics.test]
                table[f"{kind}_deg"] = np.rad2deg(turned_rad)
        runs.append(table.assign(model=folder.name, run=".".join(path.parent.relative_to(folder).parts)))
    return PathResults(metrics, pd.concat(runs, ignore_index=True))


def tables(results: Sequence[PathResults], settings: Evaluate) -> list[Table]:
    """Return the tables: nmse by range, without frames near the onset of a turn, and differences to the first model."""
    if not results:
        return []
    counts = ", ".join(f"{row.frames} frames at {_name(row)} m" for row in results[0].metrics.test)
    built = [
        Table("Path ahead", _by_range(results, lambda row: row), f"{_NOTE} {results[0].metrics.model}: {counts}."),
        Table("Path ahead, without decisions", _by_range(results, lambda row: row.without_decisions), _WITHOUT),
    ]
    shares = [
        {"model": metrics.model}
        | {f"{_name(row)} m": f"{row.coverage_68:.1%}" for row in metrics.test if row.coverage_68 is not None}
        for metrics, _ in results
    ]
    if certain := [row for row in shares if len(row) > 1]:
        built.append(Table("Path ahead, within σ", pd.DataFrame(certain).fillna(NONE), _WITHIN))
    first, *others = results
    rows = [
        {"models": f"{first.metrics.model} − {other.metrics.model}"}
        | {f"{name} m": _cell(found.nmse, found[1:]) for name, found in differences(first, other, settings).items()}
        for other in others
    ]
    if rows:
        built.append(Table("Path ahead, differences", pd.DataFrame(rows).fillna(NONE), _DIFFERENCES))
    return built


def differences(first: PathResults, second: PathResults, settings: Evaluate) -> dict[str, Difference]:
    """Return range → paired difference in nmse, for the ranges that both models predict."""
    names = [_name(row) for row in first.metrics.test if row.nmse is not None]
    common = [name for name in names if name in {_name(row) for row in second.metrics.test}]
    both = pd.concat([first.predictions, second.predictions], ignore_index=True)
    pair = first.metrics.model, second.metrics.model
    return {name: difference(both, *pair, settings, f"driven_{name}_1pm", f"predicted_{name}_1pm") for name in common}


def difference(
    predictions: pd.DataFrame,
    first: str,
    second: str,
    settings: Evaluate,
    true: str = "steering_rad",
    predicted: str = "predicted_rad",
) -> Difference:
    """Return the paired difference in nmse of two models, in the frames where all their networks predict.

    Args:
        predictions: columns model, run, drive, frame, `true` and `predicted`; rows without one of the values are left
            out.
    """
    index = ["drive", "frame"]
    counted = predictions.dropna(subset=[true, predicted])
    counted = counted.assign(error=(counted[predicted] - counted[true]) ** 2)
    by_frame = [
        counted[counted["model"] == model].pivot(index=index, columns="run", values="error").dropna().mean(axis=1)
        for model in (first, second)
    ]
    frames = counted[counted["model"] == first].drop_duplicates(index).set_index(index)
    frames = frames.assign(error=by_frame[0] - by_frame[1]).dropna(subset="error").sort_index()
    drive = frames.index.get_level_values("drive").factorize()[0]
    error, truth = frames["error"].to_numpy(), frames[true].to_numpy()
    if not truth.any():
        return Difference(np.nan, np.nan, np.nan)
    bounds = interval(error, truth, drive, settings) or (np.nan, np.nan)
    return Difference(float(error.sum() / (truth**2).sum()), *bounds)


def dvc_metrics(results: Sequence[PathResults]) -> dict[str, float]:
    """Return ``<model>.nmse_<range>m`` and its interval ``…_low`` to ``…_high``."""
    values: dict[str, float] = {}
    for metrics, _ in results:
        for row in metrics.test:
            if row.nmse is not None and row.nmse_ci95:
                key, (low, high) = f"{metrics.model}.nmse_{_name(row)}m", row.nmse_ci95
                values |= {key: row.nmse, f"{key}_low": low, f"{key}_high": high}
    return values


def _name(row: Range) -> str:
    return f"{row.from_m:g}-{row.to_m:g}"


def _by_range(results: Sequence[PathResults], part: Callable[[Range], RangeErrors]) -> pd.DataFrame:
    """Return a row per model, and per baseline of the first model that has it; `part` selects the errors of a range."""
    rows: dict[str, dict[str, str]] = {}
    for metrics, _ in results:
        for row in metrics.test:
            errors, column = part(row), f"{_name(row)} m"
            rows.setdefault(metrics.model, {})[column] = _cell(errors.nmse, errors.nmse_ci95 or (None, None))
            for baseline in ("zero", "held", "regression"):
                if baseline in errors.baselines:
                    rows.setdefault(f"*{baseline}*", {}).setdefault(column, _cell(errors.baselines[baseline]))
    models = [name for name in rows if not name.startswith("*")]
    ordered = [*models, *(name for name in rows if name not in models)]
    return pd.DataFrame([{"model": name} | rows[name] for name in ordered]).fillna(NONE)


def _cell(value: float | None, interval: Sequence[float | None] = ()) -> str:
    if value is None or pd.isna(value):
        return NONE
    return f"{value:.3f} ({interval_text(interval)})" if interval else f"{value:.3f}"
