"""All errors of a run and their differences, computed once: tables, page, DVC's metrics and
results.json have these.

A key is GROUP/ROW or, of a range, GROUP/RANGE/ROW: angle-10/motion-10, path-0/10-20 m/path. A row
is a model, a baseline, or "A - B", their paired difference in nmse. GROUP/ROW of a path is the mean
over its ranges. val/MODEL is the validation error. docs/results has the results.json of published
runs.
"""

import json
from collections.abc import Iterator, Mapping
from itertools import product
from typing import Any

import numpy as np

from pipeline.evaluate.statistics import shown_metrics
from pipeline.report.results import NO_LEARNING, Group

# key → figure, interval, frames, and what else belongs to it
Results = dict[str, dict[str, Any]]


def key(group: str, row: str, label: str = "", minus: str = "") -> str:
    """Return the key of a row, or of its difference from another one; `label`: of a range."""
    name = f"{row} - {minus}" if minus else row
    return "/".join(part for part in (group, label, name) if part)


def results(groups: list[Group], scores: Mapping[str, Any] | None = None) -> Results:
    """Return errors and differences of groups, validation errors, and errors of measured motion by
    stage scores.
    """
    figures = Results()
    for group in groups:
        labels = dict.fromkeys(["", *group.labels.values()])
        for label in labels:
            figures |= _errors(group, label)
            figures |= _differences(group, label)
        for row in group.models:
            if row["val_nmse"] < np.inf:
                known = [
                    column["nmse_by_seed"]
                    for column in row["val"].values()
                    if column["nmse"] is not None
                ]
                seeds = np.mean(known, axis=0).tolist()
                roads = len(row["drives"]["train"])
                figures[f"val/{row['model']}"] = {
                    "figure": row["val_nmse"],
                    "seeds": seeds,
                    "roads": roads,
                }
    for kind, splits in (scores or {"motion": {}})["motion"].items():
        if splits["test"]:
            figures[f"motion/{kind}"] = {
                "figure": splits["test"]["nmse"],
                "frames": splits["test"]["judged"],
            }
    return figures


def _errors(group: Group, label: str) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield key and errors of each model and baseline, in a range or, without a label, in all
    together.
    """
    column = group.column_of(label)
    for name in group.predicted:
        value, bounds = group.nmse(name, column=column)
        entry: dict[str, Any] = {"figure": value, "interval": bounds}
        if column is None:
            entry |= {"mae_deg": group.mae_deg(name)}
        else:
            scores = group.scores(name, column)
            mae_deg = scores["mae"] and np.degrees(scores["mae"] * group.length_m[column])
            entry |= {
                "frames": scores["frames"],
                "seeds": scores["by_seed"],
                "mse": scores["mse"],
                "mae_deg": mae_deg,
            }
            entry |= {metric: scores[metric] for metric in shown_metrics()}
        yield key(group.key, name, label), entry


def _differences(group: Group, label: str) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield key and paired difference of each model from each other one and from the baselines
    without the truth.
    """
    column = group.column_of(label)
    models = [row["model"] for row in group.models]
    others = [name for name in group.predicted if name in models or name in NO_LEARNING]
    for first, other in product(models, others):
        if first != other:
            value, bounds, verdict = group.difference(first, other, column)
            yield (
                key(group.key, first, label, other),
                {"figure": value, "interval": bounds, "verdict": verdict},
            )


def dvc_metrics(groups: list[Group], figures: Results) -> dict[str, Any]:
    """Return group → model or baseline → range and split → nmse, of test also its interval; DVC
    joins keys by dots.
    """
    result: dict[str, Any] = {}
    for group in groups:
        rows = {row["model"]: row for row in group.models}
        result[group.title] = {name: {} for name in group.predicted}
        for name, (column, label) in product(group.predicted, group.labels.items()):
            entry = figures[key(group.key, name, label)]
            values = {"test nmse": entry["figure"]}
            if entry["interval"]:
                values |= zip(
                    ("test nmse, 95 % from", "test nmse, 95 % to"), entry["interval"], strict=True
                )
            values |= {f"test {metric}": entry[metric] for metric in shown_metrics()}
            for split in ("train", "val"):
                if name in rows and rows[name][split]:
                    values[f"{split} nmse"] = rows[name][split][column]["nmse"]
            result[group.title][name] |= {
                f"{label} {what}".strip(): value for what, value in values.items()
            }
    return result


def rounded(figures: Results) -> Results:
    """Return the figures with numbers of five digits, as results.json has them."""
    return json.loads(json.dumps(figures), parse_float=lambda text: float(f"{float(text):.5g}"))
