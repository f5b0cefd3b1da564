"""Gather the results of all models in one table, of which results.json, tables and pages are made.

The table of values has a row per error and per paired difference of errors. Its index is:

- task: what is predicted and how many frames ahead, for instance path-0 or angle-10.
- range: a range of the path, for instance 10-20 m, whose rows have an nmse. The range without a
  name is all of them. Or an end of the path, for instance at 20 m, whose rows have an error in the
  measure of the quantity.
- row: a model, a baseline, or "A - B", the difference of A from B. Those of the error that leads
  have a verdict.

Its columns are those of :mod:`pipeline.evaluate.error_table`. Rows of models without a range have
FACTS, too. A key of results.json joins the names of the index, for instance path-0/10-20 m/path.
"""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from pipeline.base import store
from pipeline.base.errors import InputError
from pipeline.evaluate import statistics
from pipeline.evaluate.error_table import (
    COLUMNS,
    FACTS,
    Predictions,
    common_frames,
    compare_methods,
    error_table,
    frame_errors,
    to_records,
)
from pipeline.evaluate.own_metrics import METRICS
from pipeline.evaluate.settings import (
    BASELINES,
    NO_LEARNING,
    PREDICTIONS,
    Evaluate,
    find_difference,
)
from pipeline.report import paper
from pipeline.train.quantity import NMSE, Measure, Quantity, load_quantity

# Names of the index.
INDEX = ["task", "range", "row"]


@dataclass(frozen=True)
class Task:
    """Models that predict the same quantity equally far ahead, with their predictions."""

    name: str  # in keys and file names, for instance angle-0, angle-10 or path-0
    models: dict[str, dict[str, Any]]  # model → its metrics.json, those of the paper first
    predictions: Predictions
    # Those of the validation drives. None if a model lacks them, as earlier revisions do.
    validation: Predictions | None = None


def load_tasks(folders: Mapping[str, Path]) -> list[Task]:
    """Load the results of models. `folders` is model → its folder of stage evaluate.

    Raises InputError if a file is missing, or if models of a task have labels of other settings.
    """
    metrics = {}
    for model, folder in folders.items():
        metrics[model] = store.read_json(folder / "metrics.json", stage=f"evaluate@{model}")

    # Networks of the paper come first, in the order of its Table 2.
    papers = [model for model in paper.NETWORKS if model in metrics and _is_papers(metrics[model])]
    ranked = dict.fromkeys([*papers, *metrics])
    by_task: dict[tuple[str, int], dict[str, dict[str, Any]]] = {}
    for model in ranked:
        entry = metrics[model]["entry"]
        by_task.setdefault((entry["predict"], entry["horizon"]), {})[model] = metrics[model]

    # What lies ahead comes first, since the present angle can also be measured.
    ordered = sorted(by_task, key=lambda task: (not load_quantity(task[0]).is_ahead, task))
    tasks = []
    for predict, horizon in ordered:
        models = by_task[predict, horizon]
        _check_labels(models)
        labels = next(iter(models.values()))["labels"]
        quantity = load_quantity(predict)(labels, horizon)
        of_task = {model: folders[model] for model in models}
        predictions = _read_predictions(of_task, "test", quantity)
        validation = None
        if all((folder / PREDICTIONS["val"]).is_file() for folder in of_task.values()):
            validation = _read_predictions(of_task, "val", quantity)
        tasks.append(Task(f"{predict}-{horizon}", models, predictions, validation))
    return tasks


def _read_predictions(folders: Mapping[str, Path], split: str, quantity: Quantity) -> Predictions:
    """Read what models predict in the drives of a split. `folders` is model → its folder."""
    tables = {}
    for model, folder in folders.items():
        tables[model] = pd.read_csv(folder / PREDICTIONS[split], dtype={"drive": str})
    return common_frames(tables, quantity)


def _check_labels(models: Mapping[str, Mapping[str, Any]]) -> None:
    """Raise InputError if the labels of a task's models differ, which have one truth.

    `models` is model → its metrics.json.
    """
    first, *others = models
    expected = models[first]["labels"]
    for name in others:
        labels = models[name]["labels"]
        key = find_difference(expected, labels)
        if key is not None:
            problem = f"{first} was evaluated with labels.{key} = {expected.get(key, 'not set')}"
            problem += f", {name} with {labels.get(key, 'not set')}"
            fix = f"Evaluate both with the same labels: dvc repro evaluate@{first} evaluate@{name}"
            raise InputError(problem, fix=fix)


def gather_values(tasks: Sequence[Task], settings: Evaluate) -> pd.DataFrame:
    """Return the table of values of some tasks."""
    rows = {}
    for task in tasks:
        methods = [*task.predictions.predicted]
        table = error_table(task.predictions, methods, settings)
        facts = {("", model): _model_facts(task, model) for model in task.models}
        table = table.join(pd.DataFrame.from_dict(facts, orient="index", dtype=object))
        rows[task.name] = pd.concat([table, compare_methods(task.predictions, settings)])
    values = (
        pd.concat(rows) if rows else pd.DataFrame(index=pd.MultiIndex.from_tuples([], names=INDEX))
    )
    return _add_columns(values)


def _add_columns(values: pd.DataFrame) -> pd.DataFrame:
    """Return values with all columns and the names of the index."""
    values = values.reindex(columns=[*COLUMNS, *FACTS, *METRICS])
    return values.rename_axis(INDEX)


def _is_papers(content: Mapping[str, Any]) -> bool:
    """Return whether a model is that of the paper, by its metrics.json."""
    return paper.is_network(content["model"], content["entry"], content["variant"])


def sees_scene(content: Mapping[str, Any]) -> bool:
    """Return whether a model gets the scene, by its metrics.json.

    Files of earlier revisions do not say so. Only the network `blind` did not get it then.
    """
    return bool(content.get("sees_frames", content["entry"]["spatial"] != "blind"))


def _model_facts(task: Task, model: str) -> dict[str, Any]:
    """Return the FACTS of a model of a task, from its metrics.json."""
    content = task.models[model]
    quantity = task.predictions.quantity
    validation, validation_frames = _validation_error(task, model)
    return {
        "ends": [*quantity.ends] or None,
        "lead": quantity.lead or None,
        "validation": validation,
        "validation_frames": validation_frames,
        "scene": sees_scene(content),
        "paper": _is_papers(content),
        "parameters": content["parameters"],
        "edges": content["edges_per_frame"],
        "turning_frames": content["turning_frames"],
        "untrained": content["untrained"],
    }


def _validation_error(task: Task, model: str) -> tuple[float | None, int | None]:
    """Return the error of a model that leads on the validation drives, and the frames that count.

    These are the frames that all models of the task predict, or if a model lacks its predictions,
    the frames that this model predicts itself.
    """
    label = task.predictions.quantity.lead
    if task.validation is not None:
        errors = frame_errors(task.validation, model)[label]
        return statistics.mean_error(errors), int(errors.counted.any(axis=1).sum())
    of_model = task.models[model]["val"]
    if not of_model:
        return None, None
    row = of_model[f"{label}/{model}" if label else model]
    return statistics.value_of(row), row.get("frames")


def to_json(values: pd.DataFrame) -> dict[str, Any]:
    """Return the rows of values as those of results.json, with numbers of five digits."""
    text = json.dumps(to_records(values))
    return json.loads(text, parse_float=lambda number: float(f"{float(number):.5g}"))


def from_json(rows: Mapping[str, Any]) -> pd.DataFrame:
    """Return the values that :func:`to_json` made rows of."""
    index = []
    for key in rows:
        *task, row = key.split("/")
        index.append((*task, *[""] * (2 - len(task)), row))
    table = pd.DataFrame([*rows.values()], pd.MultiIndex.from_tuples(index), dtype=object)
    return _add_columns(table)


def dvc_metrics(values: pd.DataFrame) -> dict[str, dict[str, float]]:
    """Return metric → model → its number, as ``dvc metrics show`` prints them: a row per metric.

    The metric `error` is the one that leads. Metrics of METRICS are those of a quantity's only
    range, or of the range that ends where this error is.
    """
    rows: dict[str, dict[str, float]] = {name: {} for name in ("error", *METRICS)}
    for task in values.index.unique("task"):
        table = values.loc[task]
        part = _lead_range(table)
        for model in rank_models(table):
            numbers = {"error": lead_errors(table)[model]}
            for name in METRICS:
                numbers[name] = table.loc[(part, model), name]
            for name, number in numbers.items():
                if not pd.isna(number):
                    rows[name][model] = float(f"{number:.5g}")
    return rows


def _lead_range(table: pd.DataFrame) -> str:
    """Return the range that ends where the error that leads is, or "" if no end is one of a range.

    METRICS have no value in the range "" of a quantity with several ranges.
    """
    ends = list_ends(table)
    ranges = list_ranges(table)
    if len(ends) != len(ranges):
        return ""
    return dict(zip(ends, ranges, strict=True)).get(lead_label(table), "")


def frames_of(tasks: Sequence[Task]) -> dict[str, str]:
    """Return task → the frames that count, in words."""
    return {task.name: task.predictions.frames_text for task in tasks}


# The values of one task, with the index (range, row).


def quantity_of(task: str) -> type[Quantity]:
    """Return the class of the quantity that a task predicts."""
    name, _ = task.rsplit("-", 1)
    return load_quantity(name)


def title_of(task: str) -> str:
    """Return the quantity of a task in words, and how far ahead it is."""
    _, horizon = task.rsplit("-", 1)
    return quantity_of(task).title_at(int(horizon))


def list_ends(table: pd.DataFrame) -> list[str]:
    """Return the labels of the errors in the quantity's own measure, if it has any.

    Published values before 2026-11-29 have none.
    """
    ends = table["ends"].dropna()
    return [] if ends.empty else ends.iloc[0]


def list_ranges(table: pd.DataFrame) -> list[str]:
    """Return the names of the ranges, or the empty name of a quantity without ranges."""
    labels = table.index.unique("range")
    return [label for label in labels if label and label not in list_ends(table)] or [""]


def list_models(table: pd.DataFrame) -> list[str]:
    """Return the models."""
    names = table.loc[""].index
    return [name for name in names if " - " not in name and name not in BASELINES]


def list_methods(table: pd.DataFrame) -> list[str]:
    """Return the models, and the baselines after them."""
    return list_models(table) + [name for name in BASELINES if ("", name) in table.index]


def is_validated(table: pd.DataFrame) -> bool:
    """Return whether all models have a validation error."""
    return bool(table.loc[""].loc[list_models(table), "validation"].notna().all())


def has_common_validation(table: pd.DataFrame) -> bool:
    """Return whether the validation errors of all models are of equally many frames."""
    return bool(table.loc[""].loc[list_models(table), "validation_frames"].nunique() < 2)


def lead_label(table: pd.DataFrame) -> str:
    """Return the label of the error that leads. It is empty if nmse leads."""
    labels = table["lead"].dropna()
    return "" if labels.empty else str(labels.iloc[0])


def lead_errors(table: pd.DataFrame) -> pd.Series:
    """Return method or pair → the error that leads."""
    rows = table.loc[lead_label(table)]
    return rows["error"].astype(float).fillna(rows["nmse"].astype(float))


def measure_of(table: pd.DataFrame, task: str, label: str) -> Measure:
    """Return how the errors of a label are stated."""
    return quantity_of(task).measure if label in list_ends(table) else NMSE


def rank_models(table: pd.DataFrame) -> list[str]:
    """Return models by validation error, or by test error if a model has no validation error."""
    order = lead_errors(table)
    if is_validated(table):
        order = table.loc[""]["validation"].astype(float)
    order = order[list_models(table)]
    return order.sort_values(kind="stable").index.tolist()


def with_scene(table: pd.DataFrame) -> str | None:
    """Return the best model that gets the scene, if there is one."""
    seeing = [name for name in rank_models(table) if table.loc[("", name), "scene"]]
    return seeing[0] if seeing else None


def without_scene(table: pd.DataFrame) -> str | None:
    """Return the best model that does not get the scene, if there is one."""
    # Published values before 2026-11-28 do not say so: all their models get it.
    blind = [name for name in rank_models(table) if not table.loc[("", name), "scene"]]
    return blind[0] if blind else None


def best_baseline(table: pd.DataFrame) -> str:
    """Return the baseline with the least error among those that do not get the truth."""
    names = [name for name in NO_LEARNING if name in list_methods(table)]
    return str(lead_errors(table)[names].fillna(math.inf).idxmin())


def read_difference(
    table: pd.DataFrame, name: str, rival: str, label: str | None = None
) -> pd.Series:
    """Return the paired difference of a model from another, or from a baseline.

    `label` is the one that leads, if it is not given.
    """
    if label is None:
        label = lead_label(table)
    return table.loc[(label, f"{name} - {rival}")]
