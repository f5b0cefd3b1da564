"""Compute all errors of a run and their differences once, as values of results.json.

Tables, the page and DVC's metrics are made from these values, and docs/results has the values of
published runs. Their keys are:

- GROUP/ROW, for instance angle-10/motion-10. A row is a model, a baseline, or "A - B", the paired
  difference in nmse of A from B. For a quantity with ranges, it is the mean over them.
- GROUP/RANGE/ROW for a single range, for instance path-0/10-20 m/path.
- val/MODEL for a model's validation error.
- motion/KIND for the error of measured motion.
"""

import json
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from pipeline.evaluate import statistics
from pipeline.evaluate.settings import Evaluate
from pipeline.evaluate.statistics import shown_metrics
from pipeline.report import paper
from pipeline.report.results import BASELINES, NO_LEARNING, Group, Row
from pipeline.train.quantity import Quantity, load_quantity

# Key → entry, which has the nmse as `value` and further values that belong to it.
Results = dict[str, dict[str, Any]]


def results(groups: Sequence[Group], settings: Evaluate, scores: Mapping[str, Any]) -> Results:
    """Return the errors of groups, and those of measured motion.

    `scores` are the scores of stage scores, or empty.
    """
    values = Results()
    for group in groups:
        claims = paper.claims(group.models)
        # The range without a name has all columns.
        ranges = {"": [*range(len(group.quantity.columns))]}
        for column, label in enumerate(group.quantity.ranges):
            if label:
                ranges[label] = [column]
        for label, columns in ranges.items():
            key = partial(_key, group.key, label)
            for name in group.predicted:
                values[key(name)] = _errors(group, name, columns, settings)
            for name, rival in _pairs(group):
                entry = _difference(group, name, rival, columns, settings)
                values[key(f"{name} - {rival}")] = entry
            for claim in claims:
                values[key(f"{claim.model} - {claim.rival}")]["claim"] = claim.text
        for name, row in group.models.items():
            values[_key(group.key, "", name)] |= _facts(row)
            values |= {f"val/{name}": entry for entry in _validation(row)}
    for kind, splits in scores.get("motion", {}).items():
        test = splits["test"]
        if test:
            values[f"motion/{kind}"] = {"value": test["nmse"], "frames": test["judged"]}
    return values


def _key(group: str, label: str, row: str) -> str:
    return f"{group}/{label}/{row}" if label else f"{group}/{row}"


def _pairs(group: Group) -> list[tuple[str, str]]:
    """Return pairs of a model and a rival, which is another model or a fair baseline."""
    baselines = [name for name in NO_LEARNING if name in group.predicted]
    rivals = [*group.models, *baselines]
    return [(name, rival) for name in group.models for rival in rivals if name != rival]


def _squared_error(group: Group, name: str, columns: Sequence[int]) -> np.ndarray:
    """Return the squared errors [S,N,R] of a model or baseline."""
    return (group.predicted[name][..., columns] - group.truth[:, columns]) ** 2


def _errors(group: Group, name: str, columns: Sequence[int], settings: Evaluate) -> dict[str, Any]:
    """Return the errors of a model or baseline over some columns together."""
    truth = group.truth[:, columns]
    error = _squared_error(group, name, columns)
    # The number that is shown of an error in some columns, if there is none in the others.
    difference = np.zeros_like(group.predicted[name])
    difference[..., columns] = (group.predicted[name] - group.truth)[..., columns]
    shown = np.abs(group.quantity.shown(difference))
    counted = np.isfinite(truth).any(axis=1)
    entry = {
        "value": statistics.nmse_of(error, truth),
        "interval": statistics.interval(error, truth, group.drive, settings),
        "mae": None,
        "frames": int(counted.sum()),
        "drives": len(np.unique(group.drive[counted])),
        "seeds": [statistics.nmse_of(seed[None], truth) for seed in error],
    }
    if np.isfinite(shown).any():
        entry["mae"] = float(np.nanmean(shown))
    if len(columns) == 1:
        predicted = group.predicted[name][:, counted, columns[0]]
        scores = statistics.scores(truth[counted, 0], predicted)
        for metric in ("mse", *shown_metrics()):
            entry[metric] = scores[metric]
    return entry


def _difference(
    group: Group, name: str, rival: str, columns: Sequence[int], settings: Evaluate
) -> dict[str, Any]:
    """Return the paired difference in nmse of a model from another model or a baseline."""
    truth = group.truth[:, columns]
    error = _squared_error(group, name, columns)
    other = _squared_error(group, rival, columns)
    bounds = statistics.interval(error, truth, group.drive, settings, other)
    value = statistics.nmse_of(error.mean(axis=0, keepdims=True) - other.mean(axis=0), truth)

    # A baseline has no seeds.
    seeds = len(error) if rival in BASELINES else min(len(error), len(other))
    part = statistics.parts(group.drive, settings.bootstrap_block_frames)
    drives = len(np.unique(part[np.isfinite(truth).any(axis=1)]))
    verdict = statistics.verdict(bounds, seeds, drives)
    return {"value": value, "interval": bounds, "verdict": verdict}


def _facts(row: Row) -> dict[str, Any]:
    """Return further values of a model for tables, which do not depend on the group's frames."""
    test = next(iter(row["test"].values()))
    return {
        "paper": row["paper"] is not None,
        "scene": row["entry"]["spatial"] != "blind",
        "drift": test["drift_m_per_100m"],
        "parameters": row["parameters"],
        "edges": row["edges_per_frame"],
        "turning_frames": row["turning_frames"],
        "untrained": row.get("untrained", []),
    }


def _validation(row: Row) -> list[dict[str, Any]]:
    """Return a list of a model's validation error, or an empty list without validation drives.

    The error is the mean nmse over the columns.
    """
    columns = [column for column in (row["val"] or {}).values() if column["nmse"] is not None]
    if not columns:
        return []
    return [
        {
            "value": float(np.mean([column["nmse"] for column in columns])),
            "seeds": np.mean([column["nmse_by_seed"] for column in columns], axis=0).tolist(),
            "roads": len(row["drives"]["train"]),
        }
    ]


class Comparison:
    """The values of a group, which come from a run or from docs/results."""

    def __init__(self, values: Results, group: str) -> None:
        self.values = values
        self.group = group
        # A key of the group, without its name, is [ROW] or [RANGE, ROW].
        keys = [key.split("/")[1:] for key in values if key.startswith(f"{group}/")]
        rows = dict.fromkeys(key[-1] for key in keys)
        names = [name for name in rows if " - " not in name]
        # Ranges of the quantity. Without ranges, there is a single one without a name.
        self.labels = list(dict.fromkeys(key[0] for key in keys if len(key) == 2)) or [""]
        self.models = [name for name in names if name not in BASELINES]
        self.baselines = [name for name in BASELINES if name in names]

    @property
    def quantity(self) -> type[Quantity]:
        """The quantity that the group's models predict."""
        name, _ = self.group.rsplit("-", 1)
        return load_quantity(name)

    @property
    def title(self) -> str:
        """The quantity in words, and how far ahead it is."""
        _, horizon = self.group.rsplit("-", 1)
        return self.quantity.title_at(int(horizon))

    def entry(self, row: str, label: str = "") -> dict[str, Any]:
        """Return the values of a model, a baseline or a difference; they are empty if unknown."""
        return self.values.get(_key(self.group, label, row), {})

    def difference(self, name: str, rival: str, label: str = "") -> dict[str, Any]:
        """Return the paired difference of a model from another model or a baseline."""
        return self.entry(f"{name} - {rival}", label)

    @property
    def validated(self) -> bool:
        """Whether all models have a validation error."""
        return all(f"val/{name}" in self.values for name in self.models)

    @property
    def by_error(self) -> list[str]:
        """The models by validation error, or by test error if a model has no validation error."""
        return sorted(self.models, key=self._validation if self.validated else self._error)

    @property
    def without_scene(self) -> str | None:
        """The best model that does not get the scene, if there is one."""
        return next((name for name in self.by_error if not self.gets_scene(name)), None)

    def gets_scene(self, name: str) -> bool:
        """Whether a model gets the scene. Results before 2026-11-28 do not say so: they do."""
        return bool(self.entry(name).get("scene", True))

    @property
    def fair_baselines(self) -> list[str]:
        """The baselines that do not get the truth."""
        return [name for name in self.baselines if name in NO_LEARNING]

    @property
    def best_baseline(self) -> str:
        """The fair baseline with the least nmse, or the first one if several have the same nmse."""
        return min(self.fair_baselines, key=self._error)

    def _validation(self, name: str) -> float:
        return float(self.values[f"val/{name}"]["value"])

    def _error(self, name: str) -> float:
        value = self.entry(name)["value"]
        return np.inf if value is None else float(value)


def dvc_metrics(values: Results) -> dict[str, dict[str, Any]]:
    """Return key → errors of models and baselines, as ``dvc metrics show`` prints them."""
    names = ("mae", *shown_metrics())
    metrics = {}
    for key, entry in values.items():
        if " - " not in key:
            metrics[key] = {"nmse": entry["value"]}
            metrics[key] |= {name: entry[name] for name in names if name in entry}
    return metrics


def rounded(values: Results) -> Results:
    """Return the values with numbers rounded to five digits, as in results.json."""
    return json.loads(json.dumps(values), parse_float=lambda text: float(f"{float(text):.5g}"))
